//! Surface of the road at a position.

use crate::{PlantError, Surface};

/// The surface under a wheel. A function of the contact position that returns the surface has this trait.
pub trait Friction {
    /// Surface at a contact position `[x, y]`, m.
    fn surface(&self, position: [f64; 2]) -> Surface;
}

impl<F: Fn([f64; 2]) -> Surface> Friction for F {
    fn surface(&self, position: [f64; 2]) -> Surface {
        self(position)
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
        let surface = surface.into();
        surface.validate()?;
        Ok(Self(surface))
    }
}

impl Friction for Uniform {
    fn surface(&self, _position: [f64; 2]) -> Surface {
        self.0
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use egp_parameters::SurfaceError;

    use super::*;

    #[test]
    fn invalid_surfaces_are_errors() {
        assert_eq!(Uniform::new(0.0), Err(SurfaceError::Peak(0.0).into()));
        assert!(matches!(
            Uniform::new(f64::NAN),
            Err(PlantError::Surface(_))
        ));
    }
}
