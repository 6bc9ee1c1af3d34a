//! Planted faults: each is a defect that a product could have, at the boundary of one of its state machines.

use crate::oracle::Oracle;

macro_rules! mutants {
    ($($(#[doc = $text:literal])+ $name:ident => $oracle:ident,)+) => {
        /// A planted fault.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Mutant {
            $($(#[doc = $text])+ $name,)+
        }

        impl Mutant {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$name,)+];

            /// What is planted, in words.
            pub fn text(self) -> &'static str {
                match self {
                    $(Self::$name => concat!($($text),+).trim_ascii(),)+
                }
            }

            /// The oracle that must find it.
            pub fn oracle(self) -> Oracle {
                match self {
                    $(Self::$name => Oracle::$oracle,)+
                }
            }
        }
    };
}

mutants! {
    /// A command is not given.
    NoCommand => Command,
    /// A command comes after its deadline.
    LateCommand => Command,
    /// A command is given twice.
    TwoCommands => Command,
    /// A deadline is not watched, so a period without an answer has no command.
    NoDeadline => Command,
    /// The braking force exceeds its limit.
    Braking => Limits,
    /// The driving force exceeds its limit.
    Driving => Limits,
    /// The force changes faster than its limit.
    ForceSlew => Limits,
    /// The steering rate exceeds its limit.
    SteeringRate => Limits,
    /// The steering rate changes faster than its limit.
    SteeringSlew => Limits,
    /// A command is not a number.
    NotFinite => Limits,
    /// The driving force exceeds the motor's power.
    Power => Limits,
    /// A command steers beyond the largest steering angle.
    SteeringAngle => Limits,
    /// A plan is driven beyond its tail.
    LongTail => Tail,
    /// The time in which a vehicle's program is held up does not count.
    StandingClock => Tail,
    /// A command of the tail is called that of a new plan.
    TailAsNormal => Tail,
    /// An input of the tail is driven a period too late.
    TailShifted => Tail,
    /// The tail repeats the last command, as if a limit asked for it.
    TailHeld => Tail,
    /// The stop after the tail repeats the last command instead of braking.
    StopRepeats => Tail,
    /// The stop after the tail drives, as if a limit asked for it.
    StopDrives => Tail,
    /// The vehicle stops although its plan has an input for the period.
    StopsEarly => Tail,
    /// A stop ends with the next reply, without a reset.
    StopEnds => Tail,
    /// A stop coasts in place of braking.
    StopCoasts => Tail,
    /// A stop brakes as hard as the limits allow.
    StopLocks => Tail,
    /// The force of a stop does not decrease before standstill.
    StopHolds => Tail,
    /// A stop steers.
    StopSteers => Tail,
    /// The vehicle drives before the first plan.
    WaitingDrives => Tail,
    /// Half of a planned driving force is driven, as if the power asked for it.
    HalfForce => Tail,
    /// Half of a planned steering rate is driven, as if the steering angle asked for it.
    HalfSteering => Tail,
    /// The steering rate changes beyond the planned one by as much as its slew allows, as if it had not reached that one yet.
    SteeringOvershoots => Tail,
    /// The weights of a reply change places on its way.
    ChangedWeights => Match,
    /// The forces of a plan are halved on its way.
    ChangedPlan => Match,
    /// A reply has the plan and the weights of an earlier reply of the replica, to any vehicle.
    StaleReply => Match,
    /// A request is changed on its way to the engine.
    ChangedRequest => Match,
    /// The service drops one vehicle's requests.
    DroppedVehicle => Starvation,
    /// The service answers one vehicle with errors only.
    RefusedVehicle => Starvation,
    /// Tokens do not appear again once they were lost.
    LostTokens => Starvation,
    /// Answers to one vehicle are lost.
    LostAnswers => Starvation,
    /// Vehicles and replicas wait a minute before they try again to connect to a router.
    SlowReturn => Outage,
    /// A router that starts again passes on no announcements.
    MuteRouter => Outage,
    /// A reload drops the libraries from before.
    ForgottenLibrary => Library,
    /// A request is computed with the library that was loaded last, and its reply states the request's.
    ExchangedLibrary => Match,
    /// Steps wait while a library is loaded.
    BlockingReload => Answered,
    /// A worker does not end its first step.
    StuckWorker => Answered,
    /// A request is dropped without an answer.
    DroppedRequest => Answered,
    /// A request is answered twice.
    TwoAnswers => Answered,
    /// A drain drops requests that wait.
    DroppingDrain => Answered,
    /// An error is sent as bytes that are no error.
    UntypedError => Typed,
    /// An error has no code.
    ErrorWithoutCode => Typed,
    /// The queue has no bound.
    UnboundedQueue => Memory,
    /// Queries that have ended are not forgotten.
    LeakedQueries => Memory,
    /// Wake-ups are planned that are of no use.
    LeakedWakes => Memory,
    /// The time of a step is that of the real clock.
    RealClock => Repeat,
    /// The real clock decides the order of messages that are sent at the same moment.
    RandomOrder => Repeat,
}
