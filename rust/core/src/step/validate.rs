//! Checks of a request: shapes, finite numbers and the domain of the controller.

use egp_parameters::{
    MAGNITUDE, MEASURED_SPEED, MOST_LATERAL_SPEED, MOST_STEERING_ANGLE, MOST_WIDTH, MOST_YAW_RATE,
    REFERENCE_SPEED, ROAD_FRICTION, SIMPLEX_TOLERANCE,
};

use super::StepRequest;
use crate::vehicle::{DELTA, DELTA_DOT, FORCE, OMEGA, P_X, P_Y, V_X, V_Y};
use crate::{Input, Library, NU, NX, NY, NZ, Settings, State};

/// Largest magnitude of `F_x / mass` in a request, m/s².
pub(super) const MOST_ACCELERATION: f64 = 50.0;
/// Largest steering rate in a request, rad/s.
pub(super) const MOST_STEERING_RATE: f64 = 10.0;

/// A request that is invalid or does not belong to the workspace.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StepError {
    /// A field with the wrong number of values.
    #[error("`{field}` must have {expected} values ({shape}), got {found}")]
    Shape {
        /// The field.
        field: &'static str,
        /// Its shape in symbols.
        shape: &'static str,
        /// Number of values expected.
        expected: usize,
        /// Number of values in the request.
        found: usize,
    },
    /// More transitions than the window has.
    #[error(
        "`{field}` has {found} transitions, but the window is {window}; send only the newest {window}"
    )]
    Window {
        /// The field.
        field: &'static str,
        /// `K` of the settings.
        window: usize,
        /// Number of rows in the request.
        found: usize,
    },
    /// A number that is NaN, infinite, or larger than any quantity of a road vehicle in SI units.
    #[error(
        "`{field}`[{index}] is {value}; expected a finite number of magnitude at most {MAGNITUDE:e}"
    )]
    NotFinite {
        /// The field.
        field: &'static str,
        /// Index in the flat field.
        index: usize,
        /// The value that came.
        value: f64,
    },
    /// A quantity outside the domain of the controller, usually because of a wrong unit, sign or frame.
    #[error("{quantity} is {value}, outside [{min}, {max}]; check unit, sign and frame")]
    Domain {
        /// The field.
        field: &'static str,
        /// The quantity, with its field and unit.
        quantity: &'static str,
        /// The value that came.
        value: f64,
        /// Smallest accepted.
        min: f64,
        /// Largest accepted.
        max: f64,
    },
    /// Weights that are negative or do not sum to 1.
    #[error(
        "`weights` must be >= 0 and sum to 1, but their sum is {sum} and the smallest is {smallest}; send the weights of \
         the last reply or an empty list"
    )]
    Weights {
        /// Their sum.
        sum: f64,
        /// The smallest.
        smallest: f64,
    },
    /// The workspace belongs to another library or to other settings.
    #[error(
        "the workspace belongs to another library or to other settings; create a new one with `Workspace::new`"
    )]
    Workspace,
}

/// A validated request as rows.
pub(super) struct ValidRequest<'a> {
    pub x: State,
    pub u_prev: Input,
    pub weights: &'a [f64],
    pub plan_x: &'a [[f64; NX]],
    pub plan_u: &'a [[f64; NU]],
    pub plan_shift: usize,
    pub history_z: &'a [[f64; NZ]],
    pub history_y: &'a [[f64; NY]],
    pub history_f: &'a [f64],
    pub reference: &'a [[f64; 4]],
    pub widths: &'a [[f64; 2]],
    pub road_friction: &'a [[f64; 2]],
}

/// Checks shapes, finiteness and domains; `mass` in kg is that of the vehicle.
pub(super) fn validate<'a>(
    library: &Library,
    settings: &Settings,
    mass: f64,
    request: &StepRequest<'a>,
) -> Result<ValidRequest<'a>, StepError> {
    shapes(library, settings, request)?;
    let window = settings.weights.window(library);
    history_shapes(library.members().len(), window, request)?;
    finite(request)?;
    let rows = ValidRequest {
        x: State::from_column_slice(request.x),
        u_prev: Input::from_column_slice(request.u_prev),
        weights: request.weights,
        plan_x: request.plan_x.as_chunks().0,
        plan_u: request.plan_u.as_chunks().0,
        plan_shift: usize::try_from(request.plan_shift).unwrap_or(usize::MAX),
        history_z: request.history_z.as_chunks().0,
        history_y: request.history_y.as_chunks().0,
        history_f: request.history_f,
        reference: request.reference.as_chunks().0,
        widths: request.widths.as_chunks().0,
        road_friction: request.road_friction.as_chunks().0,
    };
    domains(mass, &rows)?;
    Ok(rows)
}

/// Errors unless `values` has `expected` numbers, which are the product of `shape`.
fn exact(
    [field, shape]: [&'static str; 2],
    values: &[f64],
    expected: usize,
) -> Result<(), StepError> {
    let found = values.len();
    if found == expected {
        Ok(())
    } else {
        Err(StepError::Shape {
            field,
            shape,
            expected,
            found,
        })
    }
}

/// As [`exact`]; `values` may also be empty.
fn optional(names: [&'static str; 2], values: &[f64], expected: usize) -> Result<(), StepError> {
    exact(names, values, if values.is_empty() { 0 } else { expected })
}

/// Checks all shapes but those of the history.
fn shapes(library: &Library, settings: &Settings, request: &StepRequest) -> Result<(), StepError> {
    let (n, horizon) = (library.members().len(), settings.horizon(library));
    let rows = horizon + 1;
    exact(["x", "[7]"], request.x, NX)?;
    exact(["u_prev", "[2]"], request.u_prev, NU)?;
    optional(["weights", "[N]"], request.weights, n)?;
    optional(["plan_x", "[T+1, 7]"], request.plan_x, rows * NX)?;
    let inputs = if request.plan_x.is_empty() {
        0
    } else {
        horizon * NU
    };
    let shape = "[T, 2], empty if plan_x is";
    exact(["plan_u", shape], request.plan_u, inputs)?;
    exact(["reference", "[T+1, 4]"], request.reference, rows * 4)?;
    optional(["widths", "[T+1, 2]"], request.widths, rows * 2)?;
    let road = (rows + 1) * 2;
    optional(["road_friction", "[T+2, 2]"], request.road_friction, road)
}

/// Checks the shapes of the history for `n` members and windows of at most `window` transitions.
fn history_shapes(n: usize, window: usize, request: &StepRequest) -> Result<(), StepError> {
    let transitions = request.history_z.len() / NZ;
    if transitions > window {
        return Err(StepError::Window {
            field: "history_z",
            window,
            found: transitions,
        });
    }
    let z = transitions * NZ;
    exact(["history_z", "[k, 6]"], request.history_z, z)?;
    let (shape, y) = ("[k, 3], as many rows as history_z", transitions * NY);
    exact(["history_y", shape], request.history_y, y)?;
    let predicted = (request.history_f.len() / (n * NY)).min(transitions);
    let (shape, f) = ("[k', N, 3], at most k rows", predicted * n * NY);
    exact(["history_f", shape], request.history_f, f)
}

fn finite(request: &StepRequest) -> Result<(), StepError> {
    for (field, values) in [
        ("x", request.x),
        ("u_prev", request.u_prev),
        ("weights", request.weights),
        ("plan_x", request.plan_x),
        ("plan_u", request.plan_u),
        ("history_z", request.history_z),
        ("history_y", request.history_y),
        ("history_f", request.history_f),
        ("reference", request.reference),
        ("widths", request.widths),
        ("road_friction", request.road_friction),
    ] {
        let bad = |v: &f64| v.is_nan() || v.abs() > MAGNITUDE;
        if let Some(index) = values.iter().position(bad) {
            return Err(StepError::NotFinite {
                field,
                index,
                value: values[index],
            });
        }
    }
    Ok(())
}

fn within(
    [field, quantity]: [&'static str; 2],
    value: f64,
    min: f64,
    max: f64,
) -> Result<(), StepError> {
    if (min..=max).contains(&value) {
        Ok(())
    } else {
        Err(StepError::Domain {
            field,
            quantity,
            value,
            min,
            max,
        })
    }
}

fn magnitude(names: [&'static str; 2], value: f64, most: f64) -> Result<(), StepError> {
    within(names, value, -most, most)
}

fn domains(mass: f64, rows: &ValidRequest) -> Result<(), StepError> {
    let x = &rows.x;
    let (least, most) = MEASURED_SPEED;
    within(["x", "x.v_x (m/s)"], x[V_X], least, most)?;
    magnitude(["x", "x.v_y (m/s)"], x[V_Y], MOST_LATERAL_SPEED)?;
    magnitude(["x", "x.omega (rad/s)"], x[OMEGA], MOST_YAW_RATE)?;
    let a = rows.u_prev[FORCE] / mass;
    let rate = rows.u_prev[DELTA_DOT];
    magnitude(["x", "x.delta (rad)"], x[DELTA], MOST_STEERING_ANGLE)?;
    magnitude(
        ["u_prev", "u_prev.F_x / mass (m/s^2)"],
        a,
        MOST_ACCELERATION,
    )?;
    magnitude(
        ["u_prev", "u_prev.delta_dot (rad/s)"],
        rate,
        MOST_STEERING_RATE,
    )?;
    for row in rows.reference {
        let distance = (row[0] - x[P_X]).hypot(row[1] - x[P_Y]);
        let quantity = "distance of a reference point from the vehicle (m)";
        within(["reference", quantity], distance, 0.0, 1000.0)?;
        let (least, most) = REFERENCE_SPEED;
        within(["reference", "reference.v_x (m/s)"], row[2], least, most)?;
    }
    for width in rows.widths.iter().flatten() {
        magnitude(["widths", "widths (m)"], *width, MOST_WIDTH)?;
    }
    let (least, most) = ROAD_FRICTION;
    for [friction, std] in rows.road_friction {
        let field = "road_friction";
        within([field, field], *friction, least, most)?;
        let quantity = "standard deviation of road_friction";
        within([field, quantity], *std, 0.0, most)?;
    }
    if rows.weights.is_empty() {
        return Ok(());
    }
    let sum: f64 = rows.weights.iter().sum();
    let smallest = rows.weights.iter().copied().fold(f64::INFINITY, f64::min);
    if (sum - 1.0).abs() > SIMPLEX_TOLERANCE || smallest < -SIMPLEX_TOLERANCE {
        return Err(StepError::Weights { sum, smallest });
    }
    Ok(())
}

/// Writes the previous weights, normalised to the simplex; uniform weights if the request has none.
pub(super) fn starting_weights(weights: &[f64], out: &mut [f64]) {
    if weights.is_empty() {
        out.fill(1.0 / out.len() as f64);
        return;
    }
    let sum: f64 = weights.iter().map(|w| w.max(0.0)).sum();
    for (out, w) in out.iter_mut().zip(weights) {
        *out = w.max(0.0) / sum;
    }
}
