//! Stationary kernels with one lengthscale per input dimension (ARD).
//!
//! `k(z, x) = outputscale · φ(r²)` with `r² = Σ_d (z_d - x_d)² / ℓ_d²`. A kernel is defined by its profile
//! `φ`; distances, sums over training points and gradients by the chain rule are shared by all kernels.
//!
//! To add a kernel, write a file that implements `Profile` and add it to the list and the functions of [`Kernel`].

mod exp;
mod matern52;
mod points;
mod rbf;

use matern52::Matern52;
pub(crate) use points::{Metric, Points, Query, in_blocks};
use rbf::Rbf;

use crate::simd::{Simd, Wide};

/// Number of training points in a block, over which the arithmetic is vectorised.
pub(crate) const LANES: usize = 8;
/// One number for each point of a block.
pub(crate) type Lanes = [f64; LANES];

/// The radial profile `φ` of a kernel, `φ(0) = 1`, as a function of the squared scaled distance.
///
/// The argument is `t = SCALE · r²` instead of `r`: value and slope are then smooth where points coincide, and constant
/// factors are part of the metric instead of the loop over points.
pub(crate) trait Profile {
    /// `t / r²`.
    const SCALE: f64;
    /// Constant factor of the slope.
    const SLOPE: f64;
    /// Whether slope and value are the same number, so that one sum serves for both.
    const SLOPE_IS_VALUE: bool;
    /// `φ` for a block of points.
    fn value<S: Simd>(simd: S, t: S::V) -> S::V;
    /// `φ` and `dφ/d(r²) / SLOPE` for a block of points; they share the exponential.
    fn value_slope<S: Simd>(simd: S, t: S::V) -> (S::V, S::V);
}

/// A computation that is compiled for each kernel and each instruction set.
pub(crate) trait ForKernel {
    /// Result of the computation.
    type Output;
    /// Runs the computation with the kernel `P`. Implementations must be `#[inline(always)]`.
    fn with<P: Profile, S: Simd>(self, simd: S) -> Self::Output;
}

/// A computation with one kernel, compiled for each instruction set.
#[derive(Clone, Copy)]
pub(crate) struct WithKernel<C>(Kernel, C);

impl<C: ForKernel> Wide for WithKernel<C> {
    type Output = C::Output;

    #[inline(always)]
    fn compute<S: Simd>(self, simd: S) -> C::Output {
        match self.0 {
            Kernel::Rbf => self.1.with::<Rbf, S>(simd),
            Kernel::Matern52 => self.1.with::<Matern52, S>(simd),
        }
    }
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

    /// Name in library files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rbf => "rbf",
            Self::Matern52 => "matern52",
        }
    }

    /// The kernel with this name, if it exists.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kernel| kernel.name() == name)
    }

    /// A computation with this kernel.
    pub(crate) const fn with<C: ForKernel>(self, computation: C) -> WithKernel<C> {
        WithKernel(self, computation)
    }

    /// [`Profile::SCALE`] of this kernel.
    pub(crate) const fn scale(self) -> f64 {
        match self {
            Self::Rbf => Rbf::SCALE,
            Self::Matern52 => Matern52::SCALE,
        }
    }

    /// [`Profile::SLOPE`] of this kernel.
    pub(crate) const fn slope(self) -> f64 {
        match self {
            Self::Rbf => Rbf::SLOPE,
            Self::Matern52 => Matern52::SLOPE,
        }
    }
}
