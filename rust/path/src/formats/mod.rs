//! Readers of other projects' track files.

mod centre_line;
mod raceline;

use crate::error::{PathError, check};
use crate::path::Path;

/// Reads a track in either format: `;` separates the columns of a raceline, `,` or `;` those of a centre line. Lines
/// that start with `#` are comments. The last line before the data that has the name of a column, a comment or not, is a
/// header, which must have all names, in any order. A byte order mark at the start is skipped.
///
/// * Raceline (TUM, F1TENTH): `s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2`. The path goes
///   through the positions and has no widths; psi must agree with them, measured from +x or from +y.
/// * Centre line: `x_m,y_m,w_tr_right_m,w_tr_left_m`.
///
/// Lengths are multiplied by `scale`; 10 enlarges a track of 1:10 cars to the size of real ones. The end of a `closed` track leads
/// to its start, whether or not the last line repeats the first; a track that is not closed ends at the last line.
///
/// # Errors
/// [`PathError`] if the scale is not positive, a line has too few or too many columns or a value that is not a finite
/// number, a header has some of the names and not all, the end of a closed track is far from its start, psi agrees with neither convention,
/// or [`Path::from_points`] fails. The error names the line where possible.
pub fn read_track(text: &str, scale: f64, closed: bool) -> Result<Path, PathError> {
    check("scale", scale, "a positive number", |scale| scale > 0.0)?;
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let first = text.lines().find(|line| is_row(line));
    match first {
        Some(line) if line.split(';').count() == centre_line::COLUMNS.len() => {
            centre_line::read(text, ';', scale, closed)
        }
        Some(line) if line.contains(';') => raceline::read(text, scale, closed),
        Some(_) => centre_line::read(text, ',', scale, closed),
        None => Err(PathError::TooFewPoints(0)),
    }
}

/// One row of a table, and its line in the file.
struct Row<const N: usize> {
    line: usize,
    values: [f64; N],
}

/// The rows of a table with these columns. Cells are plain numbers, so they are split here; a CSV reader would miscount
/// lines because of comments.
fn table<const N: usize>(
    text: &str,
    delimiter: char,
    columns: [&str; N],
) -> Result<Vec<Row<N>>, PathError> {
    let (header, places) = places(text, delimiter, columns)?;
    let mut in_file = columns;
    for (place, column) in places.into_iter().zip(columns) {
        in_file[place] = column;
    }
    (1..)
        .zip(text.lines())
        .filter(|(line, content)| is_row(content) && *line != header)
        .map(|(line, content)| {
            numbers(content, delimiter, in_file)
                .map(|values| Row {
                    line,
                    values: places.map(|place| values[place]),
                })
                .map_err(|problem| PathError::Format { line, problem })
        })
        .collect()
}

/// The number of the header's line, or 0 without a header, and where each column is in the file. The header is the last
/// line up to the first row that has the name of a column.
fn places<const N: usize>(
    text: &str,
    delimiter: char,
    columns: [&str; N],
) -> Result<(usize, [usize; N]), PathError> {
    let named = |content: &'_ str| -> Vec<String> {
        let comment = content.trim().trim_start_matches('#').trim();
        let names = comment.trim_end_matches([delimiter, ' ']).split(delimiter);
        names.map(|name| name.trim().to_owned()).collect()
    };
    let before = text.lines().take_while(|content| !is_row(content)).count();
    let headers = (1..)
        .zip(text.lines().take(before + 1))
        .map(|(line, content)| (line, named(content)))
        .filter(|(_, names)| names.iter().any(|name| columns.contains(&name.as_str())));
    let in_order = std::array::from_fn(|place| place);
    let Some((line, names)) = headers.last() else {
        return Ok((0, in_order));
    };
    let mut places = in_order;
    for (place, column) in places.iter_mut().zip(columns) {
        let found = names.iter().position(|name| *name == column);
        *place = found.filter(|_| names.len() == N).ok_or_else(|| {
            let problem = format!(
                "expected a header with the columns {} in any order, got {}; rename the columns, or remove this line \
                 if they have this order",
                columns.join(", "),
                names.join(", ")
            );
            PathError::Format { line, problem }
        })?;
    }
    Ok((line, places))
}

/// Whether a line is neither blank nor a comment.
fn is_row(line: &str) -> bool {
    !line.trim().is_empty() && !line.trim_start().starts_with('#')
}

fn numbers<const N: usize>(
    content: &str,
    delimiter: char,
    columns: [&str; N],
) -> Result<[f64; N], String> {
    let found = content.split(delimiter).count();
    if found != N {
        return Err(format!(
            "expected {N} columns {}, got {found}",
            columns.join(", ")
        ));
    }
    let mut values = [0.0; N];
    for ((value, cell), column) in values.iter_mut().zip(content.split(delimiter)).zip(columns) {
        let number = cell
            .trim()
            .parse()
            .ok()
            .filter(|number: &f64| number.is_finite());
        *value = number.ok_or_else(|| {
            format!(
                "expected a finite number for {column}, got {:?}",
                cell.trim()
            )
        })?;
    }
    Ok(values)
}

/// Drops a last row that repeats the first. Errors if the end of the lap is far from its start.
fn close<const N: usize>(
    rows: &mut Vec<Row<N>>,
    position: fn(&[f64; N]) -> [f64; 2],
) -> Result<(), PathError> {
    let apart = |a: &Row<N>, b: &Row<N>| {
        let (a, b) = (position(&a.values), position(&b.values));
        (b[0] - a[0]).hypot(b[1] - a[1])
    };
    let longest = rows
        .windows(2)
        .map(|pair| apart(&pair[0], &pair[1]))
        .fold(0.0, f64::max);
    let [first, .., last] = rows.as_slice() else {
        return Ok(());
    };
    let gap = apart(first, last);
    // Files repeat the first point with the rounding error of their decimals.
    if gap < 1e-3 * longest {
        rows.pop();
    } else if gap > 5.0 * longest {
        return Err(PathError::Format {
            line: last.line,
            problem: format!(
                "the last point is {gap:.2} m from the first, but adjacent points are at most {longest:.2} m \
                 apart: if this track is open, state closed = false, or --open on the command line"
            ),
        });
    }
    Ok(())
}
