//! Printed rectangles, all upright and of one size, each on a white card: what the paper's Figs. 9 to 11 look at. Between the cards there are
//! smaller, paler things, no two alike, so that points can be followed.

use super::scene::{Outline, Painter};
use crate::random::SplitMix;

/// Half the width and height of a rectangle and of its card, pixels of a camera that is 640 wide.
const HALF: [f64; 2] = [28.0, 40.0];
const CARD: [f64; 2] = [42.0, 54.0];
/// From a card to the next.
const APART: [f64; 2] = [132.0, 150.0];
/// Cards to each side of the middle.
const CARDS: [i32; 2] = [5, 4];
const THINGS: usize = 2600;
/// Red, green and blue, 0 to 255.
const WALL: [f64; 3] = [206.0, 198.0, 186.0];
const WHITE: [f64; 3] = [245.0; 3];
const BLACK: [f64; 3] = [10.0; 3];

/// Draws them for a camera of `width` pixels.
pub(super) fn draw(canvas: &mut Painter, width: u32, seed: u64) {
    let scale = f64::from(width) / 640.0;
    let middle = canvas.middle();
    let mut random = SplitMix::new(seed ^ 0x7061_7474);
    let mut paint = |outline, at: [f64; 2], half: [f64; 2], angle: f64, colour: [f64; 3]| {
        let centre = [middle[0] + at[0] * scale, middle[1] + at[1] * scale];
        canvas.paint(outline, centre, half.map(|half| half * scale), angle, colour);
    };
    paint(Outline::Rectangle, [0.0, 0.0], [4000.0, 4000.0], 0.0, WALL);
    for _ in 0..THINGS {
        let at = [random.uniform(-900.0, 900.0), random.uniform(-700.0, 700.0)];
        let half = [random.uniform(3.0, 12.0), random.uniform(3.0, 12.0)];
        let outline = if random.bits().is_multiple_of(3) { Outline::Oval } else { Outline::Rectangle };
        let tone = random.uniform(152.0, 232.0);
        paint(outline, at, half, random.uniform(0.0, 3.0), [tone, 0.99 * tone, 0.96 * tone]);
    }
    for column in -CARDS[0]..=CARDS[0] {
        for row in -CARDS[1]..=CARDS[1] {
            let at = [f64::from(column) * APART[0], f64::from(row) * APART[1]];
            paint(Outline::Rectangle, at, CARD, 0.0, WHITE);
            paint(Outline::Rectangle, at, HALF, 0.0, BLACK);
        }
    }
}
