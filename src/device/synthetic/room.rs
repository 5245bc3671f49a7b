//! A drawn room: a person at a desk before a window, a wall with pictures and a clock, and a shelf of books. Upright edges wherever one
//! looks, so that shake and slant are seen at once.

use std::f64::consts::{FRAC_PI_2, PI};

use super::scene::{Outline, Painter};
use crate::random::SplitMix;

/// Red, green and blue, 0 to 255.
type Rgb = [f64; 3];

/// The drawing's middle, in its own units; it is 2048 units wide and 1536 high.
const MIDDLE: [f64; 2] = [1024.0, 768.0];
/// Units of the drawing that fill the camera's width.
const SEEN: f64 = 1640.0;

const SKIN: Rgb = [214.0, 164.0, 134.0];
const HAIR: Rgb = [62.0, 42.0, 32.0];
const SWEATER: Rgb = [58.0, 92.0, 112.0];
const FRAME: Rgb = [236.0, 234.0, 228.0];
const DARK: Rgb = [34.0, 32.0, 34.0];
const WOOD: Rgb = [150.0, 106.0, 68.0];
const BOOKS: [Rgb; 9] = [
    [170.0, 52.0, 48.0],
    [48.0, 84.0, 132.0],
    [60.0, 112.0, 80.0],
    [206.0, 168.0, 84.0],
    [226.0, 218.0, 200.0],
    [90.0, 60.0, 96.0],
    [44.0, 52.0, 62.0],
    [196.0, 112.0, 60.0],
    [120.0, 150.0, 160.0],
];
const HOUSES: [Rgb; 4] = [[150.0, 120.0, 104.0], [168.0, 150.0, 132.0], [128.0, 132.0, 142.0], [178.0, 160.0, 120.0]];

/// Draws the room for a camera of `width` pixels; `canvas` has the texels of luma.
pub(super) fn draw(canvas: &mut Painter, width: u32, seed: u64) {
    let mut room = Room { canvas, scale: f64::from(width) / SEEN, random: SplitMix::new(seed ^ 0x726f_6f6d) };
    room.wall();
    room.window();
    room.pictures();
    room.clock();
    room.shelf();
    room.lamp();
    room.body();
    room.head();
    room.face();
    room.desk();
    room.things();
}

struct Room<'a> {
    canvas: &'a mut Painter,
    /// Texels of a unit.
    scale: f64,
    random: SplitMix,
}

/// A colour, darker or lighter.
fn shade(colour: Rgb, factor: f64) -> Rgb {
    colour.map(|value| value * factor)
}

impl Room<'_> {
    fn shape(&mut self, outline: Outline, centre: [f64; 2], half: [f64; 2], colour: Rgb, angle: f64) {
        let middle = self.canvas.middle();
        let centre = [0, 1].map(|i| middle[i] + (centre[i] - MIDDLE[i]) * self.scale);
        self.canvas.paint(outline, centre, half.map(|half| half * self.scale), angle, colour);
    }

    /// A rectangle from its top left corner, turned about its middle.
    fn turned(&mut self, [x, y]: [f64; 2], [width, height]: [f64; 2], colour: Rgb, angle: f64) {
        self.shape(Outline::Rectangle, [x + width / 2.0, y + height / 2.0], [width / 2.0, height / 2.0], colour, angle);
    }

    fn rect(&mut self, corner: [f64; 2], size: [f64; 2], colour: Rgb) {
        self.turned(corner, size, colour, 0.0);
    }

    fn oval(&mut self, centre: [f64; 2], half: [f64; 2], colour: Rgb, angle: f64) {
        self.shape(Outline::Oval, centre, half, colour, angle);
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.random.uniform(low, high)
    }

    fn one_of(&mut self, colours: &[Rgb]) -> Rgb {
        colours[(self.random.uniform(0.0, colours.len() as f64) as usize).min(colours.len() - 1)]
    }

    /// The wall goes on past the drawing's edges.
    fn wall(&mut self) {
        self.rect([-4000.0, -4000.0], [10_000.0, 10_000.0], [206.0, 196.0, 178.0]);
        for column in -40..72 {
            let x = 64.0 * f64::from(column);
            self.rect([x, -3000.0], [30.0, 7000.0], [200.0, 189.0, 170.0]);
            for row in -20..44 {
                let y = 64.0 * f64::from(row) + 32.0 * f64::from(column & 1) + 16.0;
                self.oval([x + 47.0, y], [5.0, 7.0], [184.0, 170.0, 148.0], 0.0);
            }
        }
    }

    fn window(&mut self) {
        self.rect([120.0, 180.0], [560.0, 760.0], [120.0, 104.0, 86.0]);
        self.rect([136.0, 196.0], [528.0, 728.0], [176.0, 206.0, 232.0]);
        self.rect([136.0, 366.0], [528.0, 558.0], [196.0, 218.0, 236.0]);
        for house in 0..7 {
            let (width, height) = (self.between(50.0, 90.0), self.between(120.0, 300.0));
            let (x, colour) = (160.0 + 68.0 * f64::from(house), self.one_of(&HOUSES));
            self.rect([x, 900.0 - height], [width, height], colour);
            for row in 0..(height / 34.0) as u32 {
                for column in 0..(width / 22.0) as u32 {
                    let lit = self.between(0.0, 1.0) < 0.3;
                    let colour = if lit { [236.0, 222.0, 160.0] } else { [70.0, 82.0, 98.0] };
                    self.rect(
                        [x + 6.0 + 22.0 * f64::from(column), 908.0 - height + 34.0 * f64::from(row)],
                        [12.0, 20.0],
                        colour,
                    );
                }
            }
        }
        for (corner, size) in [
            ([136.0, 196.0], [528.0, 20.0]),
            ([136.0, 550.0], [528.0, 20.0]),
            ([136.0, 896.0], [528.0, 28.0]),
            ([136.0, 196.0], [20.0, 728.0]),
            ([390.0, 196.0], [20.0, 728.0]),
            ([644.0, 196.0], [20.0, 728.0]),
            ([100.0, 924.0], [600.0, 26.0]),
        ] {
            self.rect(corner, size, FRAME);
        }
        for side in [76.0, 640.0] {
            for fold in 0..6 {
                let colour = shade([150.0, 64.0, 58.0], if fold % 2 == 0 { 0.82 } else { 1.12 });
                self.rect([side + 14.0 * f64::from(fold), 130.0], [14.0, 860.0], colour);
            }
        }
        self.rect([50.0, 116.0], [700.0, 18.0], [84.0, 66.0, 50.0]);
    }

    fn pictures(&mut self) {
        for ([x, y], [width, height], colour) in
            [([760.0, 250.0], [190.0, 240.0], [70.0, 96.0, 120.0]), ([770.0, 540.0], [150.0, 120.0], [150.0, 110.0, 70.0])]
        {
            self.rect([x - 10.0, y - 10.0], [width + 20.0, height + 20.0], [58.0, 44.0, 34.0]);
            self.rect([x, y], [width, height], FRAME);
            self.rect([x + 14.0, y + 14.0], [width - 28.0, height - 28.0], colour);
            for _ in 0..8 {
                let centre = [x + width * self.between(0.25, 0.75), y + height * self.between(0.25, 0.75)];
                let half = [width * self.between(0.05, 0.14), height * self.between(0.05, 0.14)];
                let colour = shade(colour, self.between(0.6, 1.7));
                self.oval(centre, half, colour, 0.0);
            }
        }
    }

    fn clock(&mut self) {
        let [x, y] = [1180.0, 300.0];
        self.oval([x, y], [78.0, 78.0], [52.0, 46.0, 42.0], 0.0);
        self.oval([x, y], [68.0, 68.0], [244.0, 242.0, 234.0], 0.0);
        for hour in 0..12 {
            let angle = f64::from(hour) * PI / 6.0;
            let (sin, cos) = angle.sin_cos();
            self.shape(Outline::Rectangle, [x + 56.0 * sin, y - 56.0 * cos], [2.5, 7.0], DARK, angle);
        }
        self.shape(Outline::Rectangle, [x + 14.0, y - 16.0], [3.5, 24.0], DARK, 0.75);
        self.shape(Outline::Rectangle, [x - 18.0, y - 14.0], [2.5, 32.0], DARK, -0.9);
        self.oval([x, y], [5.0, 5.0], [160.0, 40.0, 40.0], 0.0);
    }

    fn shelf(&mut self) {
        self.rect([1330.0, 140.0], [640.0, 1000.0], [104.0, 72.0, 46.0]);
        for row in 0..6 {
            let floor = 306.0 + 162.0 * f64::from(row);
            self.rect([1350.0, floor - 146.0], [600.0, 146.0], [66.0, 46.0, 32.0]);
            let mut x = 1356.0;
            while x < 1912.0 {
                if self.between(0.0, 1.0) < 0.06 {
                    x += self.between(18.0, 40.0);
                } else {
                    x += self.book(x, floor) + 1.5;
                }
            }
            self.rect([1330.0, floor], [640.0, 16.0], [120.0, 84.0, 54.0]);
        }
    }

    /// Draws a book; gives back its width.
    fn book(&mut self, x: f64, floor: f64) -> f64 {
        let (width, height) = (self.between(13.0, 34.0), self.between(92.0, 138.0));
        let colour = self.one_of(&BOOKS);
        let colour = shade(colour, self.between(0.85, 1.12));
        let (top, light) = (floor - height, shade(colour, 1.45));
        self.rect([x, top], [width, height], colour);
        self.rect([x, top], [2.0, height], shade(colour, 0.6));
        self.rect([x + 3.0, top + 12.0], [width - 6.0, 6.0], light);
        if height > 112.0 {
            self.rect([x + 3.0, top + 26.0], [width - 6.0, 3.0], light);
            self.rect([x + width / 2.0 - 2.0, top + 0.45 * height], [4.0, 0.3 * height], light);
        }
        self.rect([x + 3.0, floor - 18.0], [width - 6.0, 5.0], shade(colour, 0.7));
        width
    }

    fn lamp(&mut self) {
        let metal = [60.0, 60.0, 64.0];
        self.shape(Outline::Rectangle, [1262.0, 1000.0], [5.0, 320.0], metal, 0.0);
        self.shape(Outline::Rectangle, [1236.0, 692.0], [44.0, 5.0], metal, -0.35);
        self.oval([1196.0, 708.0], [46.0, 30.0], [214.0, 160.0, 60.0], -0.35);
    }

    fn body(&mut self) {
        self.oval([1000.0, 1250.0], [330.0, 300.0], SWEATER, 0.0);
        self.rect([670.0, 1240.0], [660.0, 300.0], SWEATER);
        for stripe in 0..9 {
            let y = 1000.0 + 44.0 * f64::from(stripe);
            let half = if y < 1250.0 { 330.0 * (1.0 - ((y - 1250.0) / 300.0f64).powi(2)).max(0.0).sqrt() } else { 330.0 };
            let colour = shade(SWEATER, if stripe % 2 == 0 { 0.78 } else { 1.35 });
            self.rect([1016.0 - half, y], [2.0 * half - 32.0, 14.0], colour);
        }
        for side in [-1.0, 1.0] {
            self.oval([1000.0 + 240.0 * side, 1300.0], [96.0, 250.0], shade(SWEATER, 0.86), -0.22 * side);
        }
        self.rect([940.0, 880.0], [120.0, 130.0], shade(SKIN, 0.86));
        self.oval([1000.0, 985.0], [92.0, 50.0], shade(SKIN, 0.86), 0.0);
        for side in [-1.0, 1.0] {
            self.shape(Outline::Rectangle, [1000.0 + 70.0 * side, 990.0], [52.0, 18.0], FRAME, -0.55 * side);
        }
    }

    fn head(&mut self) {
        self.oval([1000.0, 690.0], [170.0, 196.0], HAIR, 0.0);
        for side in [-1.0, 1.0] {
            self.oval([1000.0 + 128.0 * side, 760.0], [34.0, 52.0], SKIN, 0.0);
        }
        self.oval([1000.0, 752.0], [136.0, 176.0], SKIN, 0.0);
        self.oval([1000.0, 600.0], [150.0, 80.0], HAIR, 0.0);
        for side in [-1.0, 1.0] {
            self.oval([1000.0 + 100.0 * side, 650.0], [62.0, 92.0], HAIR, -0.5 * side);
        }
        self.oval([1030.0, 612.0], [120.0, 58.0], shade(HAIR, 1.35), 0.12);
    }

    fn face(&mut self) {
        for side in [-1.0, 1.0] {
            let x = 1000.0 + 56.0 * side;
            self.oval([x, 742.0], [27.0, 15.0], [246.0, 244.0, 240.0], 0.0);
            self.oval([x, 743.0], [13.0, 14.0], [70.0, 50.0, 36.0], 0.0);
            self.oval([x, 743.0], [6.0, 7.0], [16.0, 14.0, 12.0], 0.0);
            self.oval([x + 5.0, 738.0], [3.0, 3.0], [255.0; 3], 0.0);
            self.shape(Outline::Rectangle, [x, 706.0], [30.0, 6.0], HAIR, 0.12 * side);
            // Glasses.
            for part in 0..28 {
                let (sin, cos) = (f64::from(part) * PI / 14.0).sin_cos();
                let along = (32.0 * cos).atan2(-44.0 * sin) - FRAC_PI_2;
                self.shape(Outline::Rectangle, [x + 44.0 * cos, 744.0 + 32.0 * sin], [4.0, 6.0], DARK, along);
            }
            self.oval([1000.0 + 60.0 * side, 830.0], [26.0, 18.0], [222.0, 150.0, 126.0], 0.0);
        }
        self.shape(Outline::Rectangle, [1000.0, 738.0], [14.0, 4.0], DARK, 0.0);
        self.oval([1000.0, 800.0], [20.0, 26.0], shade(SKIN, 0.92), 0.0);
        for side in [-1.0, 1.0] {
            self.oval([1000.0 + 10.0 * side, 818.0], [6.0, 4.0], shade(SKIN, 0.66), 0.0);
        }
        self.oval([1000.0, 858.0], [46.0, 18.0], [168.0, 84.0, 76.0], 0.0);
        self.oval([1000.0, 850.0], [44.0, 12.0], SKIN, 0.0);
    }

    fn desk(&mut self) {
        self.rect([-4000.0, 1320.0], [10_000.0, 4000.0], WOOD);
        self.rect([-4000.0, 1320.0], [10_000.0, 10.0], [178.0, 132.0, 88.0]);
        for _ in 0..160 {
            let corner = [self.between(-1600.0, 3400.0), self.between(1336.0, 1900.0)];
            let (length, colour) = (self.between(120.0, 420.0), shade(WOOD, self.between(0.78, 1.15)));
            self.rect(corner, [length, 3.0], colour);
        }
    }

    /// A laptop, a mug, a plant, a sheet of paper.
    fn things(&mut self) {
        for (corner, size, colour) in [
            ([1150.0, 1130.0], [360.0, 222.0], [92.0, 96.0, 102.0]),
            ([1158.0, 1138.0], [344.0, 206.0], [168.0, 172.0, 178.0]),
            ([1130.0, 1350.0], [400.0, 20.0], [120.0, 124.0, 130.0]),
            ([560.0, 1230.0], [96.0, 120.0], [196.0, 70.0, 58.0]),
            ([560.0, 1230.0], [96.0, 12.0], [226.0, 120.0, 104.0]),
            ([570.0, 1270.0], [76.0, 8.0], [240.0, 230.0, 220.0]),
            ([570.0, 1290.0], [76.0, 8.0], [240.0, 230.0, 220.0]),
            ([260.0, 1240.0], [150.0, 110.0], [196.0, 120.0, 74.0]),
        ] {
            self.rect(corner, size, colour);
        }
        self.oval([1330.0, 1240.0], [22.0, 26.0], [206.0, 210.0, 214.0], 0.0);
        for leaf in 0..22 {
            let (angle, length) = (self.between(-1.1, 1.1), self.between(90.0, 210.0));
            let (sin, cos) = angle.sin_cos();
            let colour = shade([66.0, 128.0, 70.0], 0.65 + 0.03 * f64::from(leaf));
            self.oval([335.0 + 0.5 * length * sin, 1226.0 - 0.5 * length * cos], [16.0, 0.5 * length], colour, angle);
        }
        self.rect([250.0, 1226.0], [170.0, 24.0], [210.0, 136.0, 88.0]);
        self.turned([720.0, 1352.0], [190.0, 120.0], [240.0, 238.0, 232.0], -0.08);
        for line in 0..6 {
            let length = 150.0 - self.between(0.0, 50.0);
            self.turned([738.0, 1368.0 + 15.0 * f64::from(line)], [length, 4.0], [90.0, 90.0, 96.0], -0.08);
        }
    }
}
