//! Stationary kernels with one lengthscale per input dimension (ARD).
//!
//! `k(z, x) = outputscale · φ(r²)` with `r² = Σ_d (z_d - x_d)² / ℓ_d²`. A kernel is its profile `φ`; everything
//! around it (distances, sums over training points, gradients by the chain rule) is shared.
//!
//! Adding a kernel: one file that implements [`Profile`], one variant and its name in [`Kernel`].

mod exp;
mod matern52;
mod points;
mod rbf;

pub use matern52::Matern52;
pub use points::{Points, in_blocks, squared_distance};
pub use rbf::Rbf;

/// Training points handled together, so that the compiler vectorises the arithmetic over them.
pub const LANES: usize = 8;
/// One number for each point of a block.
pub type Lanes = [f64; LANES];

/// The radial profile `φ` of a kernel, `φ(0) = 1`, as a function of the squared scaled distance.
///
/// The argument is `r²` and not `r`, because then value and slope are smooth where the points coincide.
pub trait Profile {
    /// `φ(r²)` for a block of points.
    fn value(r2: &Lanes) -> Lanes;
    /// `φ(r²)` and `dφ/d(r²)` for a block of points; they share the exponential.
    fn value_slope(r2: &Lanes) -> (Lanes, Lanes);
}

/// The kernels a library may use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    /// Squared exponential: infinitely smooth.
    Rbf,
    /// Matérn with ν = 5/2: twice differentiable.
    Matern52,
}

impl Kernel {
    /// Every kernel.
    pub const ALL: [Self; 2] = [Self::Rbf, Self::Matern52];

    /// The name in library files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rbf => "rbf",
            Self::Matern52 => "matern52",
        }
    }

    /// The kernel of that name, if there is one.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kernel| kernel.name() == name)
    }

    /// [`Profile::value`] of this kernel.
    #[inline(always)]
    pub fn value(self, r2: &Lanes) -> Lanes {
        match self {
            Self::Rbf => Rbf::value(r2),
            Self::Matern52 => Matern52::value(r2),
        }
    }

    /// [`Profile::value_slope`] of this kernel.
    #[inline(always)]
    pub fn value_slope(self, r2: &Lanes) -> (Lanes, Lanes) {
        match self {
            Self::Rbf => Rbf::value_slope(r2),
            Self::Matern52 => Matern52::value_slope(r2),
        }
    }
}
