//! Parallel steps of many plants.

use std::num::NonZeroUsize;
use std::thread;

use crate::plant::check_step;
use crate::{Plant, PlantError, Uniform};

/// One plant of a batch with its input over the period.
#[derive(Clone, Debug)]
pub struct BatchItem {
    /// The plant, stepped in place.
    pub plant: Plant,
    /// Input `[F_x, delta_dot]`, N and rad/s.
    pub input: [f64; 2],
    /// The surface.
    pub friction: Uniform,
}

/// Smallest number of plants of a thread. A step takes tens of microseconds, as long as starting a thread.
const MIN_PER_THREAD: usize = 16;

/// Steps every plant by `dt` s on all cores. The results have the same bits as those of [`Plant::step`].
///
/// # Errors
/// [`PlantError`] if an input or `dt` is invalid; no plant is then stepped. A plant's own result is
/// [`PlantError::Spun`] or [`PlantError::Diverged`] if its step fails; this plant keeps its state, and the others are
/// stepped.
pub fn step_batch(
    items: &mut [BatchItem],
    dt: f64,
) -> Result<Vec<Result<(), PlantError>>, PlantError> {
    for item in items.iter() {
        check_step(item.input, dt)?;
    }
    let cores = thread::available_parallelism().map_or(1, NonZeroUsize::get);
    let chunk = items.len().div_ceil(cores).max(MIN_PER_THREAD);
    let mut results = vec![Ok(()); items.len()];
    let step = |items: &mut [BatchItem], results: &mut [Result<(), PlantError>]| {
        for (item, result) in items.iter_mut().zip(results) {
            *result = item.plant.step(item.input, dt, &item.friction);
        }
    };
    thread::scope(|scope| {
        for (items, results) in items.chunks_mut(chunk).zip(results.chunks_mut(chunk)) {
            scope.spawn(move || step(items, results));
        }
    });
    Ok(results)
}
