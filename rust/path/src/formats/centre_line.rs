//! Centre lines with the widths of the track: `x_m,y_m,w_tr_right_m,w_tr_left_m`.

use super::{Row, close, table};
use crate::error::PathError;
use crate::path::Path;

/// The columns in their usual order.
pub(super) const COLUMNS: [&str; 4] = ["x_m", "y_m", "w_tr_right_m", "w_tr_left_m"];

pub(super) fn read(
    text: &str,
    delimiter: char,
    scale: f64,
    closed: bool,
) -> Result<Path, PathError> {
    let mut rows = table(text, delimiter, COLUMNS)?;
    if closed {
        close(&mut rows, |&[x, y, ..]| [x, y])?;
    }
    let (points, widths): (Vec<_>, Vec<_>) = rows
        .iter()
        .map(
            |Row {
                 values: [x, y, right, left],
                 ..
             }| ([scale * x, scale * y], [scale * left, scale * right]),
        )
        .unzip();
    Path::from_points(&points, closed, Some(&widths))
}
