//! Many plants at once.

use std::num::NonZeroUsize;
use std::thread;

use crate::plant::check_step;
use crate::{Plant, PlantError, Uniform};

/// One plant of a batch with its input over the period.
#[derive(Clone, Debug)]
pub struct BatchItem {
    /// Stepped in place.
    pub plant: Plant,
    /// `[F_x, delta_dot]`, N and rad/s.
    pub input: [f64; 2],
    /// The surface it drives on.
    pub friction: Uniform,
}

/// Plants a thread should have at least: a step costs tens of microseconds, as much as starting the thread.
const PER_THREAD: usize = 16;

/// Steps every plant by `dt` on all cores; the result of each is the same, bit for bit, as stepping it alone.
///
/// # Errors
/// Of the batch: a refused input, before anything moved. Of one plant: [`PlantError::Spun`] or
/// [`PlantError::Diverged`]; it keeps its state and the others go on.
pub fn step_batch(
    items: &mut [BatchItem],
    dt: f64,
) -> Result<Vec<Result<(), PlantError>>, PlantError> {
    for item in items.iter() {
        check_step(item.input, dt)?;
    }
    let cores = thread::available_parallelism().map_or(1, NonZeroUsize::get);
    let chunk = items.len().div_ceil(cores).max(PER_THREAD);
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
