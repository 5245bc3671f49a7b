//! What multiplies a frame's correction, in one place.
//!
//! The planner ([`super::smooth`]) says where the virtual camera would like to be, within the part of the crop margin that the setting
//! `smooth.strength` gives it, less what its own `SHARE` and `SPARE` leave to other channels and to rounding. What then happens to
//! its correction, and to the motion of the rows:
//!
//! | gain | multiplies | falls because |
//! |---|---|---|
//! | trust ([`super::trust`]) | both | the motion is unknown for long |
//! | presence ([`super::presence`]) | both | stabilization is switched off |
//! | agreement ([`super::shutter::Motion::agreement`]) | the rows' motion | the pictures do not confirm it |
//! | rows' margin ([`super::crop::Window::rows_margin`]) | the rows' motion | undoing it all would show the border |
//! | margin ([`super::crop::Window::correction_part`]) | the correction | the map that it gives would show the border |

use crate::geometry::Pose;

/// The gains of a frame, each 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// How far the correction is believed.
    pub trust: f64,
    /// How far stabilization is switched on.
    pub presence: f64,
    /// The part of the rows' motion that the pictures confirm.
    pub agreement: f64,
    /// The part of the rows' motion that the crop margin allows.
    pub rows_margin: f64,
    /// The part of the correction that the crop margin allows.
    pub margin: f64,
}

impl Gains {
    /// With all of the margin.
    pub fn new(trust: f64, presence: f64, agreement: f64) -> Self {
        Self { trust, presence, agreement, rows_margin: 1.0, margin: 1.0 }
    }

    /// What fades in and out: of correction and rows alike.
    pub fn fade(&self) -> f64 {
        self.trust * self.presence
    }

    /// The part of the rows' motion that is undone.
    pub fn rows(&self) -> f64 {
        self.fade() * self.agreement * self.rows_margin
    }

    /// The correction that is made where the planner wants `wanted`.
    pub fn correction(&self, wanted: Pose) -> Pose {
        wanted * self.fade() * self.margin
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_gain_multiplies_what_it_says() {
        let gains = Gains { trust: 0.5, presence: 0.5, agreement: 0.4, rows_margin: 0.5, margin: 0.1 };
        assert_eq!(gains.fade(), 0.25);
        assert!((gains.rows() - 0.05).abs() < 1e-12);
        assert!((gains.correction(Pose([1.0, -2.0, 0.0, 4.0]))[3] - 0.1).abs() < 1e-12);
        let (whole, wanted) = (Gains::new(1.0, 1.0, 1.0), Pose([0.3, -0.1, 0.2, 0.0]));
        assert_eq!((whole.rows(), whole.correction(wanted)), (1.0, wanted));
        assert_eq!(Gains { presence: 0.0, ..whole }.correction(wanted), Pose([0.0, -0.0, 0.0, 0.0]));
    }
}
