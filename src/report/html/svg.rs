//! The elements that plots and figures consist of, as inline SVG; colours come from the style sheet.

use std::fmt::Write as _;

use maud::{Markup, html};

/// Left edge and length of the time axis of a plot that fills the page's width.
pub(super) const TIME_AXIS: (f64, f64) = (62.0, 786.0);

/// A line through points; a new one begins behind a gap.
#[derive(Clone, Debug, Default)]
pub(super) struct Line {
    data: String,
    pen_down: bool,
}

impl Line {
    /// A line through all of `points`.
    pub(super) fn through(points: impl IntoIterator<Item = [f64; 2]>) -> Self {
        let mut line = Self::default();
        points.into_iter().for_each(|point| line.to(point));
        line
    }

    /// Goes on to a point (x, y).
    pub(super) fn to(&mut self, [x, y]: [f64; 2]) {
        let command = if self.pen_down { 'L' } else { 'M' };
        let _ = write!(self.data, "{command}{x:.1} {y:.1}");
        self.pen_down = true;
    }

    /// Goes on straight up or down.
    pub(super) fn vertical_to(&mut self, y: f64) {
        let _ = write!(self.data, "V{y:.1}");
    }

    /// The next point begins a line of its own.
    pub(super) fn gap(&mut self) {
        self.pen_down = false;
    }

    /// Goes back to where it began.
    pub(super) fn close(mut self) -> Self {
        self.data.push('Z');
        self
    }

    /// As path data.
    pub(super) fn data(&self) -> &str {
        &self.data
    }

    /// As an element of the style sheet's class `class`.
    pub(super) fn drawn(&self, class: &str) -> Markup {
        html! { path class=(class) d=(self.data) {} }
    }
}

/// A label at (x, y); `class` says how it is aligned.
pub(super) fn label([x, y]: [f64; 2], class: &str, text: impl maud::Render) -> Markup {
    html! { text x=(rounded(x)) y=(rounded(y)) class=(class) { (text) } }
}

/// A coordinate with one digit after the point.
pub(super) fn rounded(value: f64) -> String {
    format!("{value:.1}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_lift_the_pen_and_labels_are_escaped() {
        let mut line = Line::through([[0.0, 1.0], [2.0, 3.0]]);
        line.gap();
        line.to([4.0, 5.25]);
        line.vertical_to(7.0);
        assert_eq!(
            line.close().drawn("line after").0,
            "<path class=\"line after\" d=\"M0.0 1.0L2.0 3.0M4.0 5.2V7.0Z\"></path>"
        );
        assert_eq!(
            label([1.0, 2.0], "x", "a<b & \"c\"").0,
            "<text x=\"1.0\" y=\"2.0\" class=\"x\">a&lt;b &amp; &quot;c&quot;</text>"
        );
    }
}
