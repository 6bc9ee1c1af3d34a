//! Vehicles that are evaluated together for one input.

use super::axles::{Axles, Forces, Motion, Slopes, VEHICLES};
use super::{SingleTrack, VehicleModel};
use crate::{GpInput, GpJacobian, GpOutput};

/// Vehicles in a fixed order, some of which may be missing. The forces of up to four single-track vehicles at consecutive
/// places are computed together; the results are the same bits as those of each vehicle alone. A vehicle with several
/// steps in a period is evaluated alone.
#[derive(Clone, Debug)]
pub(crate) struct Batch {
    dt: f64,
    /// Empty if all are missing.
    vehicles: Vec<Option<VehicleModel>>,
    /// The axles of four places each; `None` if no place has a single-track vehicle.
    groups: Vec<Option<Axles>>,
}

impl Batch {
    /// A batch of vehicles over periods of `dt` s.
    pub fn new(vehicles: impl Iterator<Item = Option<VehicleModel>>, dt: f64) -> Self {
        let mut vehicles: Vec<_> = vehicles.collect();
        if vehicles.iter().all(Option::is_none) {
            vehicles.clear();
        }
        let groups = vehicles.chunks(VEHICLES).map(|group| {
            // A place without a single-track vehicle of one step has the axles of another one, whose results are not used.
            let at = |place: usize| single_track(group.get(place)?.as_ref());
            let any = (0..VEHICLES).find_map(at)?;
            Some(SingleTrack::axles(|place| at(place).unwrap_or(any)))
        });
        Self {
            dt,
            groups: groups.collect(),
            vehicles,
        }
    }

    /// Writes the change of `[v_x, v_y, omega]` over the period by each vehicle to its place, and leaves a place without
    /// vehicle as it is.
    pub fn changes(&self, z: &GpInput, out: &mut [GpOutput]) {
        let mut motion = None;
        let groups = self.vehicles.chunks(VEHICLES).zip(&self.groups);
        for ((group, axles), out) in groups.zip(out.chunks_mut(VEHICLES)) {
            let forces = axles.as_ref().map(|axles| {
                let motion = *motion.get_or_insert_with(|| Motion::new(z, self.dt));
                (motion, axles.forces(&motion))
            });
            for (place, (vehicle, out)) in group.iter().zip(out).enumerate() {
                let Some(vehicle) = vehicle else { continue };
                *out = match (single_track(Some(vehicle)), &forces) {
                    (Some(vehicle), Some((motion, forces))) => {
                        vehicle.change_by(motion, forces, place)
                    }
                    _ => vehicle.change(z),
                };
            }
        }
    }

    /// The vehicles at the input `z`, for [`Tangents::change_jacobian`].
    pub fn tangents(&self, z: &GpInput) -> Tangents<'_> {
        Tangents {
            batch: self,
            z: *z,
            group: None,
        }
    }
}

/// The vehicles of a [`Batch`] at one input, of which those that are asked for are evaluated.
#[derive(Clone, Debug)]
pub(crate) struct Tangents<'a> {
    batch: &'a Batch,
    z: GpInput,
    /// The group that was evaluated last.
    group: Option<Group>,
}

/// The forces of one group of a [`Batch`].
#[derive(Clone, Debug)]
struct Group {
    index: usize,
    motion: Motion,
    forces: Forces,
    slopes: Slopes,
}

impl Tangents<'_> {
    /// The change by the vehicle at a place, and its Jacobian; `None` if there is none.
    ///
    /// Four vehicles are evaluated at once, so ascending places are the fastest.
    pub fn change_jacobian(&mut self, place: usize) -> Option<(GpOutput, GpJacobian)> {
        let vehicle = self.batch.vehicles.get(place)?.as_ref()?;
        let (index, place) = (place / VEHICLES, place % VEHICLES);
        let (Some(single_track), Some(axles)) =
            (single_track(Some(vehicle)), &self.batch.groups[index])
        else {
            return Some(vehicle.change_jacobian(&self.z));
        };
        if self.group.as_ref().is_none_or(|group| group.index != index) {
            let motion = Motion::new(&self.z, self.batch.dt);
            let (forces, slopes) = axles.forces_and_slopes(&motion);
            self.group = Some(Group {
                index,
                motion,
                forces,
                slopes,
            });
        }
        let group = self.group.as_ref()?;
        Some(single_track.change_jacobian_by(&group.motion, &group.forces, &group.slopes, place))
    }
}

/// The vehicle at a place if it is a single-track one with one step in a period.
fn single_track(vehicle: Option<&VehicleModel>) -> Option<&SingleTrack> {
    match vehicle {
        Some(VehicleModel::SingleTrack(vehicle)) if vehicle.steps() == 1 => Some(vehicle),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::vehicle::example::{CAR, MODEL_CAR, inputs};
    use crate::vehicle::{Kinematic, ModelParameters};

    const DT: f64 = 0.02;
    /// Two groups: single-track vehicles that differ in all parameters, of which one has two steps and one is a model car, one
    /// vehicle without slip, and a place without vehicle.
    fn vehicles() -> Vec<Option<VehicleModel>> {
        (0..7)
            .map(|place| {
                let factor = 1.0 + 0.1 * f64::from(place);
                match place {
                    2 => None,
                    3 => {
                        let parameters = [1200.0, 1.0, 1.5].map(|p| p * factor);
                        Some(VehicleModel::Kinematic(Kinematic::new(&parameters, DT)))
                    }
                    _ => {
                        let car = if place == 6 { MODEL_CAR } else { CAR };
                        let parameters = ModelParameters::SingleTrack(car.map(|p| p * factor));
                        let steps = if place == 5 { 2 } else { 1 };
                        Some(VehicleModel::new(&parameters, DT).with_steps(steps))
                    }
                }
            })
            .collect()
    }

    #[test]
    fn each_vehicle_predicts_as_it_does_alone() {
        let vehicles = vehicles();
        let batch = Batch::new(vehicles.iter().copied(), DT);
        let mut changes = vec![GpOutput::zeros(); vehicles.len()];
        for z in inputs() {
            batch.changes(&z, &mut changes);
            let alone = |vehicle: &Option<VehicleModel>| {
                vehicle.map_or(GpOutput::zeros(), |vehicle| vehicle.change(&z))
            };
            assert_eq!(changes, vehicles.iter().map(alone).collect::<Vec<_>>());
        }
    }

    #[test]
    fn without_vehicles_there_is_nothing_to_predict() {
        let batch = Batch::new([None, None].into_iter(), DT);
        let mut changes = [GpOutput::repeat(1.0); 2];
        batch.changes(&inputs()[0], &mut changes);
        assert_eq!(changes, [GpOutput::repeat(1.0); 2]);
        assert_eq!(batch.tangents(&inputs()[0]).change_jacobian(1), None);
    }

    #[test]
    fn tangents_are_the_same_in_any_order() {
        let vehicles = vehicles();
        let batch = Batch::new(vehicles.iter().copied(), DT);
        for z in inputs() {
            let mut tangents = batch.tangents(&z);
            for place in [0, 5, 1, 2, 3, 6, 4] {
                let alone = vehicles[place].map(|vehicle| vehicle.change_jacobian(&z));
                assert_eq!(tangents.change_jacobian(place), alone);
            }
        }
    }
}
