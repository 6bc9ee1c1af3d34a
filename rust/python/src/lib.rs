//! The `_core` extension: adapters between Python and the Rust crates, nothing else.

#![allow(clippy::needless_pass_by_value)] // pyo3 hands arguments over by value

// The documentation of what the package's public interface can reach, from the stubs in `python/egp_service/_core`.
include!(concat!(env!("OUT_DIR"), "/doc.rs"));

mod array;
mod belief;
mod checks;
mod discovery;
mod driver;
mod driver_arguments;
mod error;
mod failure;
mod fleet;
mod gate;
mod library;
mod library_writer;
mod map;
mod member;
mod ocp;
mod parameters;
mod path;
mod plant;
mod problem;
mod problem_arguments;
mod problem_checks;
mod problem_export;
mod programs;
mod projection;
mod residual;
mod service;
mod speed;
mod surface;
mod testing;
mod text;
mod traces;
mod weights;
mod wire;

/// The private extension module behind `egp_service`; each submodule has a stub of its name.
#[pyo3::pymodule(module = "egp_service")]
mod _core {
    use pyo3::prelude::*;

    #[pymodule]
    mod belief {
        use pyo3::prelude::*;
        use pyo3::types::PyTuple;

        #[pymodule_export]
        use crate::belief::{RoadBelief, SpeedPlanner, merge_tiles};

        #[pymodule_init]
        fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
            let hypotheses = egp_parameters::friction_hypotheses();
            let hypotheses = PyTuple::new(module.py(), hypotheses)?;
            module.add("FRICTION_HYPOTHESES", hypotheses)
        }
    }

    #[pymodule]
    mod driver {
        #[pymodule_export]
        use crate::discovery::Discover;
        #[pymodule_export]
        use crate::driver::{Decision, Driver, Query};
    }

    #[pymodule]
    mod error {
        #[pymodule_export]
        use crate::error::{
            EgpError, InvalidArgumentError, LibraryError, RefusedError, VehicleLostError,
        };
    }

    #[pymodule]
    mod fleet {
        #[pymodule_export]
        use crate::fleet::{FleetExchange, FleetNotice, MapQuery};
    }

    #[pymodule]
    mod library {
        #[pymodule_export]
        use crate::library::Library;
        #[pymodule_export]
        use crate::library_writer::{MemberData, write_library, write_library_subset};
        #[pymodule_export]
        use crate::member::Member;
    }

    #[pymodule]
    mod map {
        #[pymodule_export]
        use crate::map::{check_map, serve_map};
    }

    #[pymodule]
    mod optimal_control {
        #[pymodule_export]
        use crate::ocp::{OcpMultipliers, OcpResult, ocp_to_qp, solve_ocp};
        #[pymodule_export]
        use crate::problem::{OcpBounds, OcpWeights};
        #[pymodule_export]
        use crate::residual::predict_residual;
        #[pymodule_export]
        use crate::weights::solve_weights;
    }

    #[pymodule]
    mod path {
        #[pymodule_export]
        use crate::path::Path;
        #[pymodule_export]
        use crate::projection::Projection;
        #[pymodule_export]
        use crate::speed::{SpeedProfile, horizon_reference};
    }

    #[pymodule]
    mod plant {
        #[pymodule_export]
        use crate::plant::Plant;
        #[pymodule_export]
        use crate::surface::surface_friction;
    }

    #[pymodule]
    mod programs {
        #[pymodule_export]
        use crate::programs::{run_load, run_simulation};
    }

    #[pymodule]
    mod service {
        #[pymodule_export]
        const SETTINGS_DOCUMENT: &str = include_str!("../../../docs/settings.md");
        #[pymodule_export]
        use crate::checks::{
            available_cores, check_certificates, check_service, check_settings, refused_setting,
            vector_instructions,
        };
        #[pymodule_export]
        use crate::service::{Engine, InProcessDriver, Server, fetch_library, serve};
    }

    #[pymodule]
    mod testing {
        #[pymodule_export]
        const MAP_HEALTH_KEY: &str = egp_wire::road_keys::HEALTH;
        #[pymodule_export]
        const MAP_METRICS_KEY: &str = egp_wire::road_keys::METRICS;
        #[pymodule_export]
        use crate::gate::{Command, Gate};
        #[pymodule_export]
        use crate::testing::{
            MapServer, decode_timing, live_key, plant_derivative, plant_initial_states,
            plant_lateral_acceleration, ready_key, step_key,
        };
        #[pymodule_export]
        use crate::wire::{Refusal, decode_error};
    }

    #[pymodule]
    mod vehicle {
        #[pymodule_export]
        const GRAVITY: f64 = egp_parameters::GRAVITY;
        #[pymodule_export]
        const FULL_SIZE: f64 = egp_parameters::FULL_SIZE;
        #[pymodule_export]
        const MIN_SLIP_SPEED: f64 = egp_parameters::MIN_SLIP_SPEED;
        #[pymodule_export]
        const STANDARD_GRAVITY: f64 = egp_parameters::STANDARD_GRAVITY;
        #[pymodule_export]
        use crate::parameters::{VehicleParameters, slip_speed};
    }

    #[pymodule]
    mod wire {
        #[pymodule_export]
        const LIVE_KEYS: &str = egp_wire::keys::ALL_LIVE;
        #[pymodule_export]
        const LOAD_KEYS: &str = egp_wire::keys::ALL_LOADS;
        #[pymodule_export]
        const VEHICLE_KEYS: &str = egp_wire::keys::ALL_VEHICLES;
        #[pymodule_export]
        use crate::wire::{
            Friction, Replica, Reply, Request, decode_ready, decode_reply, decode_request,
            file_descriptor_set, publishing_vehicle, replica_of_live, replica_of_load, vehicle_key,
            vehicle_road_key,
        };
    }

    /// Makes the submodules importable, and the names of all but `testing` also names of this module.
    #[pymodule_init]
    fn init(core: &Bound<'_, PyModule>) -> PyResult<()> {
        let loaded = core.py().import("sys")?.getattr("modules")?;
        for submodule in core.index()? {
            let name: String = submodule.extract()?;
            let submodule = core.getattr(&name)?.cast_into::<PyModule>()?;
            if name != "testing" {
                for name in submodule.index()? {
                    let name: String = name.extract()?;
                    core.setattr(&name, submodule.getattr(&name)?)?;
                }
            }
            submodule.delattr("__all__")?;
            loaded.set_item(format!("egp_service._core.{name}"), submodule)?;
        }
        core.delattr("__all__") // The stubs say what is public.
    }
}
