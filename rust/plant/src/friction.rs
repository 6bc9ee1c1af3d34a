//! Surface of the road at a position.

use crate::{PlantError, Surface};

/// The surface under a wheel.
pub trait Friction {
    /// Surface at a contact position `[x, y]`, m.
    fn surface(&self, position: [f64; 2]) -> Surface;
}

impl<F: Friction + ?Sized> Friction for &F {
    fn surface(&self, position: [f64; 2]) -> Surface {
        (**self).surface(position)
    }
}

/// The same surface everywhere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Uniform(Surface);

impl Uniform {
    /// A road of one surface, or of the friction coefficient `mu`.
    ///
    /// # Errors
    /// [`PlantError::Surface`] if the surface is out of range.
    pub fn new(surface: impl Into<Surface>) -> Result<Self, PlantError> {
        checked(surface.into()).map(Self)
    }
}

impl Friction for Uniform {
    fn surface(&self, _position: [f64; 2]) -> Surface {
        self.0
    }
}

/// Surfaces on a regular grid aligned with the axes, constant within a cell. Outside the grid the surface is that of
/// the nearest border cell.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    origin: [f64; 2],
    cell: f64,
    columns: usize,
    rows: usize,
    values: Vec<Surface>,
}

impl Map {
    /// A grid of `rows x columns` square cells of side `cell` (m) whose lower left corner is `origin` (m).
    ///
    /// `values` are surfaces or friction coefficients in row-major order; rows increase along +y, columns along +x.
    ///
    /// # Errors
    /// [`PlantError::MapShape`], [`PlantError::MapCell`], [`PlantError::NotFinite`], [`PlantError::Surface`].
    pub fn new(
        origin: [f64; 2],
        cell: f64,
        [rows, columns]: [usize; 2],
        values: Vec<impl Into<Surface>>,
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
        let values = values
            .into_iter()
            .map(|value| checked(value.into()))
            .collect::<Result<_, _>>()?;
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
    fn surface(&self, position: [f64; 2]) -> Surface {
        // Float to integer casts saturate, so positions left of or below the grid use its first cells.
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let index = |i: usize, count: usize| {
            (((position[i] - self.origin[i]) / self.cell) as usize).min(count - 1)
        };
        self.values[index(1, self.rows) * self.columns + index(0, self.columns)]
    }
}

/// The surface if it is within range.
pub(crate) fn checked(surface: Surface) -> Result<Surface, PlantError> {
    surface.validate()?;
    Ok(surface)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use egp_parameters::SurfaceError;

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
        assert_eq!(map.surface([10.5, -4.0]).friction(), 0.1);
        assert_eq!(map.surface([13.9, -3.1]).friction(), 0.2);
        assert_eq!(map.surface([14.1, -2.9]).friction(), 0.6);
        assert_eq!(map.surface([-1e9, 1e9]).friction(), 0.4);
        assert_eq!(map.surface([1e9, -1e9]).friction(), 0.3);
    }

    #[test]
    fn invalid_surfaces_are_errors() {
        assert_eq!(Uniform::new(0.0), Err(SurfaceError::Peak(0.0).into()));
        assert!(matches!(
            Uniform::new(f64::NAN),
            Err(PlantError::Surface(_))
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
            Err(SurfaceError::Peak(-1.0).into())
        );
    }
}
