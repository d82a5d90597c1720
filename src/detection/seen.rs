//! A corner as it was seen in a micro-image, and how that depends on what was taken for granted.

use nalgebra::{Vector2, Vector3};

use super::CornerObservation;
use super::corner::Corner;
use super::edge_width::EdgeWidth;
use super::levers::{Levers, STEPS};

/// An observation of a corner, made with the slope and the aberration that were known before. Places are
/// straightened, see [`super::aberration`].
pub(super) struct Seen {
    pub observation: CornerObservation,
    pub corner: Corner,
    /// γ₀, the slope that its line had before.
    pub slope_before: f64,
    /// By how much the observation moves with that slope and the aberration.
    pub levers: Levers,
    /// What its edges say of the blur.
    pub width: Option<EdgeWidth>,
}

impl Seen {
    /// The observation as it enters the line: its place i + (γ − γ₀) lever = β + γ c is a line in γ as well, that
    /// of i − γ₀ lever over c − lever. So the slope and the blur that follows from it are found together;
    /// by turns, each round would leave half of an error.
    pub fn on_line(&self) -> CornerObservation {
        CornerObservation {
            center: self.observation.center - self.levers.by_slope,
            position: self.observation.position - self.levers.by_slope * self.slope_before,
            ..self.observation
        }
    }

    /// [`Seen::on_line`] if one of what is taken from white images is larger by its part of [`STEPS`].
    pub fn on_line_with(&self, taken: usize) -> CornerObservation {
        let on_line = self.on_line();
        let moved = self.levers.by_taken.column(taken) * STEPS[taken];
        CornerObservation { position: on_line.position + moved, ..on_line }
    }

    /// Adds to a lever what follows from how the slope of the line changes with it.
    pub fn take_slope(&mut self, taken: usize, slope: f64) {
        let by_slope = self.levers.by_slope * slope;
        let mut lever = self.levers.by_taken.column_mut(taken);
        lever += by_slope;
    }

    /// Moves the observation to where another aberration puts it.
    pub fn change_aberration(&mut self, change: &Vector3<f64>) {
        self.moved(&(self.levers.by_aberration * change));
    }

    /// Moves the observation to where the blur radius of another slope puts it.
    pub fn change_slope(&mut self, slope: f64) {
        self.moved(&(self.levers.by_slope * (slope - self.slope_before)));
        self.slope_before = slope;
    }

    fn moved(&mut self, by: &Vector2<f64>) {
        self.observation.position += by;
        self.corner.place += by;
    }
}
