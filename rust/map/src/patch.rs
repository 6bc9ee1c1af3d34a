//! Evidence about a patch, whose friction is independent of that of the road around it.

use crate::grid::{Row, multiply};

/// Distance in m that a patch is assumed to extend at least on both sides of a place on it. Evidence within this distance is
/// evidence about the patch.
pub(crate) const PATCH: f64 = 8.0;

/// The product of each `window` successive rows, at the index of the last of them. The first `window - 1` rows of the
/// result have no meaning.
///
/// The rows are divided into blocks of `window`. Each product is that of the rows to the end of one block and of those from
/// the start of the next one, so that it takes three multiplications whatever the window (van Herk, *A fast algorithm for
/// local minimum and maximum filters on rectangular and octagonal kernels*, Pattern Recognition Letters 13, 1992).
pub(crate) fn products(rows: &[Row], window: usize) -> Vec<Row> {
    let mut products: Vec<Row> = Vec::with_capacity(rows.len());
    for (i, row) in rows.iter().enumerate() {
        products.push(*row);
        if i % window != 0 {
            let (before, from_start) = products.split_at_mut(i);
            multiply(&mut from_start[0], &before[i - 1]);
        }
    }
    let mut to_end = [1.0; _];
    for (i, row) in rows.iter().enumerate().rev() {
        if (i + 1) % window == 0 {
            to_end = [1.0; _];
        }
        multiply(&mut to_end, row);
        if i % window != 0
            && let Some(from_start) = products.get_mut(i + window - 1)
        {
            multiply(from_start, &to_end);
        }
    }
    products
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_are_those_of_all_windows() {
        let rows: Vec<Row> = (0..23)
            .map(|row| std::array::from_fn(|i| 0.5 + ((row * 7 + i * 3) % 11) as f64 / 10.0))
            .collect();
        for window in [1, 2, 5, 9, 23] {
            let found = products(&rows, window);
            assert_eq!(found.len(), rows.len());
            for (found, rows) in found[window - 1..].iter().zip(rows.windows(window)) {
                for (i, found) in found.iter().enumerate() {
                    let expected: f64 = rows.iter().map(|row| row[i]).product();
                    assert!((found / expected - 1.0).abs() < 1e-12);
                }
            }
        }
    }
}
