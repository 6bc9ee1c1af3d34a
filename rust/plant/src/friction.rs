//! Friction of the road at a position.

use crate::PlantError;

/// The friction coefficient under a wheel.
///
/// The coefficient `mu` is the ratio of the longitudinal peak force to the load; for the lateral force it is `0.9 mu`.
pub trait Friction {
    /// Coefficient at a contact position `[x, y]`, m.
    fn coefficient(&self, position: [f64; 2]) -> f64;
}

impl<F: Friction + ?Sized> Friction for &F {
    fn coefficient(&self, position: [f64; 2]) -> f64 {
        (**self).coefficient(position)
    }
}

/// A surface of constant friction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Uniform(f64);

impl Uniform {
    /// A surface of coefficient `mu`.
    ///
    /// # Errors
    /// [`PlantError::Friction`] unless `mu` is finite and positive.
    pub fn new(mu: f64) -> Result<Self, PlantError> {
        checked(mu).map(Self)
    }
}

impl Friction for Uniform {
    fn coefficient(&self, _position: [f64; 2]) -> f64 {
        self.0
    }
}

/// Friction on a regular grid aligned with the axes, constant within a cell. Outside the grid the friction is that of
/// the nearest border cell.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    origin: [f64; 2],
    cell: f64,
    columns: usize,
    rows: usize,
    values: Vec<f64>,
}

impl Map {
    /// A grid of `rows x columns` square cells of side `cell` (m) whose lower left corner is `origin` (m).
    ///
    /// `values` are in row-major order; rows increase along +y, columns along +x.
    ///
    /// # Errors
    /// [`PlantError::MapShape`], [`PlantError::MapCell`], [`PlantError::NotFinite`], [`PlantError::Friction`].
    pub fn new(
        origin: [f64; 2],
        cell: f64,
        [rows, columns]: [usize; 2],
        values: Vec<f64>,
    ) -> Result<Self, PlantError> {
        for coordinate in origin {
            crate::error::finite("map origin", coordinate)?;
        }
        if !(cell.is_finite() && cell > 0.0) {
            return Err(PlantError::MapCell(cell));
        }
        if values.is_empty() || rows * columns != values.len() {
            return Err(PlantError::MapShape {
                expected: rows * columns,
                got: values.len(),
            });
        }
        for &value in &values {
            checked(value)?;
        }
        Ok(Self {
            origin,
            cell,
            columns,
            rows,
            values,
        })
    }
}

impl Friction for Map {
    fn coefficient(&self, position: [f64; 2]) -> f64 {
        // Float to integer casts saturate, so positions left of or below the grid use its first cells.
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let index = |i: usize, count: usize| {
            (((position[i] - self.origin[i]) / self.cell) as usize).min(count - 1)
        };
        self.values[index(1, self.rows) * self.columns + index(0, self.columns)]
    }
}

/// `mu` if it is finite and positive.
pub(crate) fn checked(mu: f64) -> Result<f64, PlantError> {
    if mu.is_finite() && mu > 0.0 {
        Ok(mu)
    } else {
        Err(PlantError::Friction(mu))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn map_is_constant_within_cells_and_extends_its_border() {
        let map = Map::new(
            [10.0, -5.0],
            2.0,
            [2, 3],
            vec![0.1, 0.2, 0.3, 0.4, 0.5, 0.6],
        )
        .unwrap();
        assert_eq!(map.coefficient([10.5, -4.0]), 0.1);
        assert_eq!(map.coefficient([13.9, -3.1]), 0.2);
        assert_eq!(map.coefficient([14.1, -2.9]), 0.6);
        assert_eq!(map.coefficient([-1e9, 1e9]), 0.4);
        assert_eq!(map.coefficient([1e9, -1e9]), 0.3);
    }

    #[test]
    fn invalid_surfaces_are_errors() {
        assert_eq!(Uniform::new(0.0), Err(PlantError::Friction(0.0)));
        assert!(matches!(
            Uniform::new(f64::NAN),
            Err(PlantError::Friction(_))
        ));
        assert_eq!(
            Map::new([0.0; 2], 1.0, [2, 2], vec![1.0]),
            Err(PlantError::MapShape {
                expected: 4,
                got: 1
            })
        );
        assert_eq!(
            Map::new([0.0; 2], 0.0, [1, 1], vec![1.0]),
            Err(PlantError::MapCell(0.0))
        );
        assert_eq!(
            Map::new([0.0; 2], 1.0, [1, 1], vec![-1.0]),
            Err(PlantError::Friction(-1.0))
        );
    }
}
