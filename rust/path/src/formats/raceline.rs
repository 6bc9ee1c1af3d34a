//! Racelines: `s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2`.

use std::f64::consts::FRAC_PI_2;

use super::{Row, close, table};
use crate::error::PathError;
use crate::path::{Path, wrap_angle};

/// Largest mean error in rad between psi and the direction of travel; with the wrong convention the error is a quarter
/// turn.
const HEADING_TOLERANCE: f64 = 0.2;

pub(super) fn read(text: &str, scale: f64, closed: bool) -> Result<Path, PathError> {
    let columns = [
        "s_m",
        "x_m",
        "y_m",
        "psi_rad",
        "kappa_radpm",
        "vx_mps",
        "ax_mps2",
    ];
    let mut rows = table(text, ';', columns)?;
    if closed {
        close(&mut rows, |&[_, x, y, ..]| [x, y])?;
    }
    if let Some(pair) = rows
        .windows(2)
        .find(|pair| pair[1].values[0] <= pair[0].values[0])
    {
        return Err(PathError::Format {
            line: pair[1].line,
            problem: format!(
                "s_m must increase, got {} after {}",
                pair[1].values[0], pair[0].values[0]
            ),
        });
    }
    let points: Vec<_> = rows
        .iter()
        .map(|row| [scale * row.values[1], scale * row.values[2]])
        .collect();
    let path = Path::from_points(&points, closed, None)?;
    check_heading(&rows, closed)?;
    Ok(path)
}

/// Compares psi with the direction from the point before each point to the one after it, measured from +x (as here) and from
/// +y (as in the trajectory tools of TUM). At an end of an open path one of these two is the point itself. The path uses the
/// positions only; headings that agree with neither convention indicate wrong columns or a wrong order of the points.
fn check_heading(rows: &[Row<7>], closed: bool) -> Result<(), PathError> {
    let count = rows.len();
    let mean_error = |quarter: f64| {
        let errors = (0..count).map(|i| {
            let (before, after) = if closed {
                ((i + count - 1) % count, (i + 1) % count)
            } else {
                (i.saturating_sub(1), (i + 1).min(count - 1))
            };
            let (before, after) = (&rows[before].values, &rows[after].values);
            let travel = (after[2] - before[2]).atan2(after[1] - before[1]);
            let error = rows[i].values[3] + quarter - travel;
            wrap_angle(error).abs()
        });
        errors.sum::<f64>() / count as f64
    };
    let (from_x, from_y) = (mean_error(0.0), mean_error(FRAC_PI_2));
    if from_x.min(from_y) <= HEADING_TOLERANCE {
        Ok(())
    } else {
        Err(PathError::Heading { from_x, from_y })
    }
}
