//! Wider vector instructions where the machine has them: the only file of this crate with `unsafe`.
//!
//! Code marked `#[inline(always)]` is compiled once for the baseline and once with AVX2 and FMA. The features are
//! looked up when the program runs, so one binary serves every machine and gives the same bits on machines that have
//! the same features.
#![allow(unsafe_code)]

/// A computation that is compiled for several instruction sets.
pub(crate) trait Vectorised {
    /// What it returns.
    type Output;
    /// Does it. Implementations are `#[inline(always)]`, or they are not vectorised.
    fn compute(self) -> Self::Output;
}

/// Runs a computation with the best instruction set this machine has.
pub(crate) fn vectorised<V: Vectorised>(computation: V) -> V::Output {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2,fma")]
        fn avx2<V: Vectorised>(computation: V) -> V::Output {
            computation.compute()
        }
        if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma")
        {
            // SAFETY: both features were found on this machine.
            return unsafe { avx2(computation) };
        }
    }
    computation.compute()
}
