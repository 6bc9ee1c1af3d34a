//! Errors of loading a library file.

use egp_parameters::ParameterError;

use crate::Kernel;

/// An error of loading a library file. The library that is served, if there is one, does not change.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LibraryError {
    /// More bytes than a library may have.
    #[error("file has more than {limit} bytes; train with fewer points or members")]
    TooLarge {
        /// Largest accepted size.
        limit: usize,
    },
    /// The file begins as a Parquet file does.
    #[error(
        "this is a Parquet file, such as the datasets of `egp collect`; `egp train FILE -o library.safetensors` makes a library of it"
    )]
    Parquet,
    /// The header's length field is beyond the limit; nothing of it was parsed.
    #[error(
        "this is not a library file: its first bytes state a header of {bytes} bytes, and the limit is {limit}; give a library of `egp train`"
    )]
    HeaderTooLarge {
        /// What the length field says.
        bytes: u64,
        /// Largest accepted header.
        limit: usize,
    },
    /// The file is shorter or longer than its header states.
    #[error(
        "the header states {expected} bytes, but the file has {found}; copy or export it again"
    )]
    Length {
        /// Bytes that the header states.
        expected: usize,
        /// Bytes present.
        found: usize,
    },
    /// Not a safetensors file, or one without the metadata of this format.
    #[error("not a library file: {reason}; export one with `egp train`")]
    Malformed {
        /// What the parser found.
        reason: String,
    },
    /// Bytes changed after the file was written.
    #[error(
        "file is corrupt: it was sealed with SHA-256 {expected}, but its content gives {found}; copy it again"
    )]
    Corrupt {
        /// Digest in the metadata.
        expected: String,
        /// Digest of the content.
        found: String,
    },
    /// Written for another version of the format.
    #[error(
        "schema version is {found}, this program reads {supported}; export the library again with it"
    )]
    SchemaVersion {
        /// Version of the file.
        found: u32,
        /// Version understood here.
        supported: u32,
    },
    /// The metadata lack a field, have an unknown one, or one of the wrong type.
    #[error("metadata do not follow the schema: {reason}; export the library again")]
    Metadata {
        /// What the parser found.
        reason: String,
    },
    /// Other inputs, outputs or units than those of the vehicle equations.
    #[error("signals are {found}, expected {expected}; convert the data and train again")]
    Signals {
        /// Names and units in the file.
        found: String,
        /// Names and units used here.
        expected: String,
    },
    /// A kernel that is not built in.
    #[error(
        "kernel is \"{found}\", but the supported ones are {}; train with one of these",
        Kernel::ALL.map(Kernel::name).join(", ")
    )]
    UnknownKernel {
        /// Name in the file.
        found: String,
    },
    /// The control period is out of range.
    #[error(
        "dt is {found} s, it must be within {min} s and {max} s; collect data at such a period"
    )]
    TimeStep {
        /// Value in the file.
        found: f64,
        /// Smallest accepted.
        min: f64,
        /// Largest accepted.
        max: f64,
    },
    /// A vehicle parameter is out of range.
    #[error("{0}; correct the vehicle that the library is trained for")]
    Vehicle(ParameterError),
    /// A standard deviation of the measurement noise of `[v_x, v_y, omega]` (m/s, m/s, rad/s) is out of range.
    #[error(
        "measurement noise is {found:?}, each standard deviation must be within 0 and 100; leave it out or train again"
    )]
    MeasurementNoise {
        /// Values in the file.
        found: [f64; crate::NY],
    },
    /// The measurement delay is out of range.
    #[error(
        "measurement delay is {found} s, it must be within 0 and 0.5; leave it out or train again"
    )]
    MeasurementDelay {
        /// Value in the file.
        found: f64,
    },
    /// Too few or too many members, points or golden points.
    #[error("number of {what} is {found}, it must be within 1 and {limit}")]
    Count {
        /// What is counted.
        what: String,
        /// Number in the file.
        found: usize,
        /// Largest accepted number.
        limit: usize,
    },
    /// An empty label, or one that two members have.
    #[error("member label \"{label}\" is empty or used twice; give every surface its own name")]
    Label {
        /// The label.
        label: String,
    },
    /// A friction coefficient that is not a positive number.
    #[error("friction of member \"{label}\" is {found}, it must be a positive number")]
    Friction {
        /// Member.
        label: String,
        /// Value in the file.
        found: f64,
    },
    /// A number of steps of the Euler method that is out of range.
    #[error(
        "euler_steps of member \"{label}\" is {found}, it must be 1 to {limit} for this kind of member"
    )]
    EulerSteps {
        /// Member.
        label: String,
        /// Value in the file.
        found: u32,
        /// Largest number.
        limit: u32,
    },
    /// Two single-track vehicles have different numbers of Euler steps, so that none lies between them.
    #[error(
        "euler_steps of member \"{label}\" is {found}, and {first} of another member: all single-track vehicles of a library \
         have the same number"
    )]
    DifferentEulerSteps {
        /// Member.
        label: String,
        /// Value in the file.
        found: u32,
        /// Value of an earlier member.
        first: u32,
    },
    /// A tensor that must be there is not.
    #[error("tensor \"{tensor}\" is missing; export the library again")]
    MissingTensor {
        /// Name.
        tensor: String,
    },
    /// A tensor that has no place in the format.
    #[error("tensor \"{tensor}\" does not belong in a library; remove it or export again")]
    UnexpectedTensor {
        /// Name.
        tensor: String,
    },
    /// Other numbers than 64-bit floats.
    #[error("tensor \"{tensor}\" has type {found}, expected F64; train in double precision")]
    DataType {
        /// Name.
        tensor: String,
        /// Type in the file.
        found: String,
    },
    /// A tensor of another shape.
    #[error("tensor \"{tensor}\" has shape {found:?}, expected {expected:?}")]
    Shape {
        /// Name.
        tensor: String,
        /// Expected.
        expected: Vec<usize>,
        /// Found.
        found: Vec<usize>,
    },
    /// NaN or infinity.
    #[error(
        "tensor \"{tensor}\" holds {value} at flat index {index}; check the data and train again"
    )]
    NonFinite {
        /// Name.
        tensor: String,
        /// Flat index of the first such number.
        index: usize,
        /// The number.
        value: f64,
    },
    /// A scale, lengthscale or variance that is not positive, or beyond 1e-100 to 1e100.
    #[error(
        "tensor \"{tensor}\" must be positive (1e-100 to 1e100), it holds {value} at flat index {index}; train again"
    )]
    NotPositive {
        /// Name.
        tensor: String,
        /// Flat index of the first such number.
        index: usize,
        /// The number.
        value: f64,
    },
    /// The envelope's lower bound is not below its upper bound.
    #[error(
        "tensor \"{tensor}\": `{input}` has min {min}, which is not below max {max}; export again"
    )]
    Envelope {
        /// Name.
        tensor: String,
        /// Name of the GP input.
        input: &'static str,
        /// Lower bound.
        min: f64,
        /// Upper bound.
        max: f64,
    },
    /// `K + s² I` cannot be factored.
    #[error(
        "covariance behind \"{tensor}\" is not positive definite for output {output} at training point {point}; \
         remove repeated points or train with more noise"
    )]
    NotPositiveDefinite {
        /// Name of the tensor with the training inputs.
        tensor: String,
        /// Index of the output.
        output: usize,
        /// Row where the factorisation failed.
        point: usize,
    },
    /// `alpha` does not solve its linear system.
    #[error(
        "\"{tensor}\" leaves the residual {residual:e} in (K + s² I) alpha = y - m for output {output}, \
         at most {tolerance:e} is allowed; compute it by an exact Cholesky solve in double precision"
    )]
    Alpha {
        /// Name.
        tensor: String,
        /// Index of the output.
        output: usize,
        /// Largest residual, z-scored.
        residual: f64,
        /// Largest accepted.
        tolerance: f64,
    },
    /// The self-test on stored predictions failed.
    #[error(
        "self-test failed: \"{tensor}\" stores {expected:e} at flat index {index}, computed {found:e}, \
         allowed difference {tolerance:e}; the exporter and this program disagree on the model"
    )]
    Golden {
        /// Name.
        tensor: String,
        /// Flat index.
        index: usize,
        /// Stored prediction.
        expected: f64,
        /// Prediction made here.
        found: f64,
        /// Accepted difference.
        tolerance: f64,
    },
    /// A member that the library does not have.
    #[error("there is no member {index}: the library has {count}, counted from 0")]
    NoMember {
        /// Index asked for.
        index: usize,
        /// Members of the library.
        count: usize,
    },
}

impl LibraryError {
    /// A short, stable name of the error, for programs.
    pub const fn code(&self) -> &'static str {
        match self {
            Self::TooLarge { .. } => "too_large",
            Self::Parquet => "parquet",
            Self::HeaderTooLarge { .. } => "header_too_large",
            Self::Length { .. } => "length",
            Self::Malformed { .. } => "malformed",
            Self::Corrupt { .. } => "corrupt",
            Self::SchemaVersion { .. } => "schema_version",
            Self::Metadata { .. } => "metadata",
            Self::Signals { .. } => "signals",
            Self::UnknownKernel { .. } => "unknown_kernel",
            Self::TimeStep { .. } => "time_step",
            Self::Vehicle(_) => "vehicle",
            Self::MeasurementNoise { .. } => "measurement_noise",
            Self::MeasurementDelay { .. } => "measurement_delay",
            Self::Count { .. } => "count",
            Self::Label { .. } => "label",
            Self::Friction { .. } => "friction",
            Self::EulerSteps { .. } | Self::DifferentEulerSteps { .. } => "euler_steps",
            Self::MissingTensor { .. } => "missing_tensor",
            Self::UnexpectedTensor { .. } => "unexpected_tensor",
            Self::DataType { .. } => "data_type",
            Self::Shape { .. } => "shape",
            Self::NonFinite { .. } => "non_finite",
            Self::NotPositive { .. } => "not_positive",
            Self::Envelope { .. } => "envelope",
            Self::NotPositiveDefinite { .. } => "not_positive_definite",
            Self::Alpha { .. } => "alpha",
            Self::Golden { .. } => "golden",
            Self::NoMember { .. } => "no_member",
        }
    }
}
