//! The friction that a step found.

use egp_parameters::{FRICTION_HYPOTHESES, FRICTION_INFORMED, LEAST_LOG_LIKELIHOOD};

use crate::Invalid;
use crate::fields::{Fields, once};

/// Posterior of the friction coefficient, from the transitions of the request.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Friction {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub std: f64,
    /// 5 % quantile.
    pub lower: f64,
    /// 95 % quantile.
    pub upper: f64,
    /// Information in the transitions: Kullback-Leibler divergence from the prior, in nats.
    pub information: f64,
    /// Logarithm of the likelihood of each of [`egp_parameters::friction_hypotheses`], relative to the largest.
    pub log_likelihood: [f64; FRICTION_HYPOTHESES],
    /// Test of the likeliest friction for bias: 1 on average if the members' predictions have no systematic error, and larger if no
    /// friction explains the transitions. 0 without transitions, and from older services.
    pub misfit: f64,
}

/// Largest friction coefficient that is read.
const LARGEST: f64 = 10.0;
/// Largest information that is read, nats.
const MOST_INFORMATION: f64 = 1e3;
/// Largest misfit that is read.
const MOST_MISFIT: f64 = 1e9;
const LOG_LIKELIHOOD: u32 = 6;
const MISFIT: u32 = 7;
const FIELD: &str = "friction";

impl Friction {
    /// Whether the transitions have information about the friction: at least [`FRICTION_INFORMED`].
    pub fn informed(&self) -> bool {
        self.information >= FRICTION_INFORMED
    }

    /// The numbers, in the order of their tags.
    pub(crate) fn values(&self) -> [f64; 5] {
        [
            self.mean,
            self.std,
            self.lower,
            self.upper,
            self.information,
        ]
    }

    /// Reads and validates an `egp.v1.Friction`.
    pub(crate) fn read(message: &[u8]) -> Result<Self, Invalid> {
        let mut values = [0.0; 5];
        let (mut log_likelihood, mut misfit) = (None, 0.0);
        for field in Fields::of(message) {
            let (tag, value) = field?;
            if tag == LOG_LIKELIHOOD {
                once(FIELD, &mut log_likelihood, hypotheses(value.bytes(FIELD)?)?)?;
            } else if tag == MISFIT {
                misfit = value.double(FIELD)?;
            } else if let Some(slot) = (tag as usize)
                .checked_sub(1)
                .and_then(|i| values.get_mut(i))
            {
                *slot = value.double(FIELD)?;
            }
        }
        let [mean, std, lower, upper, information] = values;
        let friction = Self {
            mean,
            std,
            lower,
            upper,
            information,
            log_likelihood: log_likelihood.unwrap_or([0.0; _]),
            misfit,
        };
        friction.validate()?;
        Ok(friction)
    }

    /// Errors unless all values are in their ranges and the interval's ends are in order.
    pub(crate) fn validate(&self) -> Result<(), Invalid> {
        let [mean, std, lower, upper, information] = self.values();
        for (name, value, limit) in [
            ("mean", mean, LARGEST),
            ("std", std, LARGEST),
            ("lower", lower, LARGEST),
            ("upper", upper, LARGEST),
            ("information", information, MOST_INFORMATION),
            ("misfit", self.misfit, MOST_MISFIT),
        ] {
            if !(0.0..=limit).contains(&value) {
                let detail = format!("expected {name} in [0, {limit}], got {value}");
                return Err(Invalid::field(FIELD, detail));
            }
        }
        if let Some(value) = (self.log_likelihood.iter())
            .find(|value| !(LEAST_LOG_LIKELIHOOD..=0.0).contains(*value))
        {
            let detail =
                format!("expected log_likelihood in [{LEAST_LOG_LIKELIHOOD}, 0], got {value}");
            return Err(Invalid::field(FIELD, detail));
        }
        if self.lower > self.upper {
            let detail = format!("lower = {} is above upper = {}", self.lower, self.upper);
            return Err(Invalid::field(FIELD, detail));
        }
        Ok(())
    }
}

/// Errors unless there is a number for each hypothesis.
fn hypotheses(bytes: &[u8]) -> Result<[f64; FRICTION_HYPOTHESES], Invalid> {
    let (values, rest) = bytes.as_chunks();
    let values: Result<&[[u8; 8]; FRICTION_HYPOTHESES], _> = values.try_into();
    match (values, rest) {
        (Ok(values), []) => Ok(values.map(f64::from_le_bytes)),
        _ => Err(Invalid::field(
            FIELD,
            format!(
                "expected {FRICTION_HYPOTHESES} numbers in log_likelihood, got {} bytes",
                bytes.len()
            ),
        )),
    }
}
