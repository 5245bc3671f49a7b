//! The mesh against the map: pictures that tell from which column or row each sample was taken.

use super::*;
use crate::geometry::{Homography, Pinhole, Pose, RowPoses};
use crate::image::Picture;
use crate::random::Congruential;

const SAMPLINGS: [Sampling; 4] = [Sampling::Mono, Sampling::S420, Sampling::S422, Sampling::S444];

/// The mesh is judged by what bilinear sampling makes of rulers.
const LINEAR: Params = Params { filter: Some(Filter::Bilinear) };

/// Grey levels from one sample to the next; every four it begins again.
const SLOPE: f64 = 64.0;

/// A picture whose planes rise along x (`axis` 0) or y (1).
fn ruler(sampling: Sampling, [width, height]: [usize; 2], axis: usize) -> Picture {
    let mut picture = Picture::new(sampling, width, height);
    for plane in &mut picture.as_mut().planes {
        for y in 0..plane.height() {
            for (x, out) in plane.row_mut(y).iter_mut().enumerate() {
                *out = ([x, y][axis] % 4 * 64) as u8;
            }
        }
    }
    picture
}

fn noise(sampling: Sampling, width: usize, height: usize) -> Picture {
    let mut picture = Picture::new(sampling, width, height);
    let mut generator = Congruential::new(1);
    for plane in &mut picture.as_mut().planes {
        for y in 0..plane.height() {
            for out in plane.row_mut(y) {
                *out = generator.byte();
            }
        }
    }
    picture
}

/// Distance between luma samples and chroma samples, and the first chroma sample's place, luma pixels; written out once more.
fn lattice(sampling: Sampling, siting: Siting, plane: usize) -> ([f64; 2], [f64; 2]) {
    match (plane, sampling, siting) {
        (0, ..) | (_, Sampling::S444 | Sampling::Mono, _) => ([1.0, 1.0], [0.0, 0.0]),
        (_, Sampling::S422, _) => ([2.0, 1.0], [0.0, 0.0]),
        (_, Sampling::S420, Siting::Centre) => ([2.0, 2.0], [0.5, 0.5]),
        (_, Sampling::S420, Siting::Left) => ([2.0, 2.0], [0.0, 0.5]),
        (_, Sampling::S420, Siting::TopLeft) => ([2.0, 2.0], [0.0, 0.0]),
    }
}

/// The largest distance, in luma pixels along one axis, between where a sample was taken and where `map` says; of each plane. The
/// first and last rows, as many as a cell is high, are left out: see [`the_rows_at_the_edge_are_off_by_little_more`].
fn worst(map: &OutputMap, sampling: Sampling, siting: Siting, input: [usize; 2], output: [usize; 2]) -> [f64; 3] {
    let cell = 8.0 * (input[0] as f64 / output[0] as f64).max(input[1] as f64 / output[1] as f64);
    worst_within(cell + 2.0, map, sampling, siting, input, output)
}

/// As [`worst`], `rim` rows left out.
fn worst_within(
    rim: f64,
    map: &OutputMap,
    sampling: Sampling,
    siting: Siting,
    input: [usize; 2],
    output: [usize; 2],
) -> [f64; 3] {
    let mut worst = [0.0f64; 3];
    let mut compared = [0usize; 3];
    let mut drawn = Picture::new(sampling, output[0], output[1]);
    for axis in 0..2 {
        let picture = ruler(sampling, input, axis);
        Warper::new(&LINEAR, Level::detected(), siting).draw(map, picture.as_ref(), &mut drawn.as_mut());
        for (plane, (seen, from)) in drawn.as_ref().planes.iter().zip(picture.as_ref().planes).enumerate() {
            let (scale, offset) = lattice(sampling, siting, plane);
            for y in 0..seen.height() {
                for x in 0..seen.width() {
                    let here = [x as f64 * scale[0] + offset[0], y as f64 * scale[1] + offset[1]];
                    let to = map.apply(here);
                    let to = [0, 1].map(|i: usize| (to[i] - offset[i]) / scale[i]);
                    let size = [from.width(), from.height()];
                    let rim = [1.0, rim / scale[1]];
                    let inside = (0..2).all(|i| to[i] > rim[i] && to[i] < size[i] as f64 - 1.0 - rim[i]);
                    // where the ruler begins again it tells nothing, nor where a small error could reach over its end
                    let along = to[axis].rem_euclid(4.0);
                    if !inside || !(0.2..2.8).contains(&along) {
                        continue;
                    }
                    let error = (f64::from(seen.at(x, y)) - SLOPE * along).abs() / SLOPE * scale[axis];
                    worst[plane] = worst[plane].max(error);
                    compared[plane] += 1;
                }
            }
        }
    }
    assert!(compared[0] > output[0] * output[1] / 2, "too little was compared: {compared:?}");
    worst
}

/// Views as they come: a zoom of a tenth, and turns as hands, walks and pans ask for.
fn turns(camera: &Pinhole, view: &Homography) -> Vec<Homography> {
    let degrees = |yaw: f64, pitch: f64, roll: f64, zoom: f64| {
        let turn = camera.turned(Pose([yaw.to_radians(), pitch.to_radians(), roll.to_radians(), zoom]));
        Homography(turn.0 * view.0)
    };
    vec![
        degrees(0.0, 0.0, 0.0, 0.0),
        degrees(2.0, 0.0, 0.0, 0.0),
        degrees(-1.0, 1.5, 0.5, 0.01),
        degrees(0.3, -2.0, -4.0, 0.0),
        degrees(0.0, 0.0, 2.0, -0.03),
    ]
}

/// Rows that moved as a camera moves: steadily, in a knock of a desk (10 Hz, 1 degree), in a turn with roll; readout 25 ms.
fn row_motions(height: usize) -> Vec<RowPoses> {
    let motion = |at: &dyn Fn(f64) -> [f64; 4]| RowPoses {
        samples: std::array::from_fn(|i| Pose(at(0.025 * (i as f64 / (RowPoses::SAMPLES - 1) as f64 - 0.5)))),
        spacing: (height as f64 - 1.0) / (RowPoses::SAMPLES - 1) as f64,
    };
    let knock = |t: f64| 1f64.to_radians() * (std::f64::consts::TAU * 10.0 * t + 0.7).sin() - 1f64.to_radians() * 0.7f64.sin();
    vec![
        motion(&|t| [1.0 * t, 0.0, 0.0, 0.0]),
        motion(&|t| [0.0, -0.7 * t, 0.0, 0.0]),
        motion(&|t| [0.4 * knock(t), knock(t), 0.2 * knock(t), 0.0]),
        motion(&|t| [0.5 * t, 0.4 * t, 0.5 * t, 0.05 * t]),
    ]
}

fn middle_view(input: [usize; 2], output: [usize; 2], zoom: f64) -> Homography {
    let scale = (input[0] as f64 / output[0] as f64).max(input[1] as f64 / output[1] as f64) / zoom;
    let shift = |i: usize| (input[i] as f64 - 1.0) / 2.0 - scale * (output[i] as f64 - 1.0) / 2.0;
    Homography(nalgebra::Matrix3::new(scale, 0.0, shift(0), 0.0, scale, shift(1), 0.0, 0.0, 1.0))
}

/// Measured at 640x480 and 60 degrees: 0.011 px for turns, 0.012 px with rows in motion, nearly all of it the 8 bits of a sample and
/// of a weight.
#[test]
fn the_mesh_is_off_by_less_than_a_twentieth_of_a_pixel() {
    let size = [640, 480];
    let camera = Pinhole::new(size, 60.0);
    let view = middle_view(size, size, 1.1);
    for (i, turn) in turns(&camera, &view).into_iter().enumerate() {
        let [off, ..] = worst(&OutputMap::Projective(turn), Sampling::Mono, Siting::Centre, size, size);
        println!("turn {i}: {off:.4} px");
        assert!(off < 0.05, "turn {i}: {off} px");
        for (j, rows) in row_motions(size[1]).into_iter().enumerate() {
            let [off, ..] = worst(
                &OutputMap::Rows { window: Homography::IDENTITY, view: turn, camera, kept: camera.bend, rows },
                Sampling::Mono,
                Siting::Centre,
                size,
                size,
            );
            println!("turn {i}, rows {j}: {off:.4} px");
            assert!(off < 0.05, "turn {i}, rows {j}: {off} px");
        }
    }
}

/// Outside the picture no row moves on, so the map bends at its edge, and the cells there are off by up to
/// the cell's height / 4 * motion of a row.
#[test]
fn the_rows_at_the_edge_are_off_by_little_more() {
    let size = [640, 480];
    let camera = Pinhole::new(size, 60.0);
    let view = middle_view(size, size, 1.1);
    for turn in turns(&camera, &view) {
        for rows in row_motions(size[1]) {
            let map = OutputMap::Rows { window: Homography::IDENTITY, view: turn, camera, kept: camera.bend, rows };
            let [off, ..] = worst_within(1.0, &map, Sampling::Mono, Siting::Centre, size, size);
            assert!(off < 0.08, "{off} px");
        }
    }
}

#[test]
fn luma_and_chroma_stay_together() {
    for size in [[320, 240], [157, 93]] {
        let camera = Pinhole::new(size, 60.0);
        let view = middle_view(size, size, 1.15);
        let [.., turn] = turns(&camera, &view)[..] else { unreachable!() };
        let rows = row_motions(size[1])[2];
        for map in [
            OutputMap::Projective(turn),
            OutputMap::Rows { window: Homography::IDENTITY, view: turn, camera, kept: camera.bend, rows },
        ] {
            for sampling in SAMPLINGS {
                for siting in [Siting::Centre, Siting::Left, Siting::TopLeft] {
                    let off = worst(&map, sampling, siting, size, size);
                    // a chroma sample of 4:2:0 spans two pixels, so its 8 bits are twice as coarse
                    assert!(off[0] < 0.05 && off[1] < 0.06 && off[2] < 0.06, "{sampling:?} {siting:?} {size:?}: {off:?} px");
                }
            }
        }
    }
}

#[test]
fn pictures_of_another_size_are_drawn_as_the_map_says() {
    for (input, output) in [([320, 240], [160, 120]), ([160, 120], [320, 240]), ([200, 100], [101, 67]), ([64, 48], [641, 481])]
    {
        let camera = Pinhole::new(input, 60.0);
        let view = middle_view(input, output, 1.1);
        for map in [
            OutputMap::Projective(turns(&camera, &view)[2]),
            OutputMap::Rows {
                window: Homography::IDENTITY,
                view: turns(&camera, &view)[1],
                camera,
                kept: 0.0,
                rows: row_motions(input[1])[3],
            },
        ] {
            for sampling in [Sampling::S420, Sampling::S444] {
                let off = worst(&map, sampling, Siting::Centre, input, output);
                assert!(off.iter().all(|&off| off < 0.06), "{input:?} to {output:?}: {off:?} px");
            }
        }
    }
}

#[test]
fn the_identity_copies_exactly() {
    let still = |size: [usize; 2]| OutputMap::Rows {
        window: Homography::IDENTITY,
        view: Homography::IDENTITY,
        camera: Pinhole::new(size, 60.0),
        kept: 0.0,
        rows: RowPoses { samples: [Pose::default(); RowPoses::SAMPLES], spacing: 1.0 },
    };
    for [width, height] in [[1, 1], [2, 2], [3, 1], [16, 8], [17, 9], [33, 23], [101, 67], [640, 48]] {
        for sampling in SAMPLINGS {
            for siting in [Siting::Centre, Siting::Left, Siting::TopLeft] {
                for map in [OutputMap::default(), still([width, height])] {
                    for level in Level::all() {
                        let picture = noise(sampling, width, height);
                        let mut drawn = Picture::new(sampling, width, height);
                        Warper::new(&LINEAR, level, siting).draw(&map, picture.as_ref(), &mut drawn.as_mut());
                        assert!(drawn == picture, "{width}x{height} {sampling:?} {siting:?} {}", level.name());
                    }
                }
            }
        }
    }
}

#[test]
fn every_level_draws_the_same() {
    let size = [333, 222];
    let camera = Pinhole::new(size, 60.0);
    let picture = noise(Sampling::S420, size[0], size[1]);
    let view = middle_view(size, size, 1.1);
    for rows in row_motions(size[1]) {
        let map =
            OutputMap::Rows { window: Homography::IDENTITY, view: turns(&camera, &view)[3], camera, kept: camera.bend, rows };
        let drawn = Level::all().map(|level| {
            let mut drawn = Picture::new(Sampling::S420, size[0], size[1]);
            Warper::new(&LINEAR, level, Siting::Left).draw(&map, picture.as_ref(), &mut drawn.as_mut());
            drawn
        });
        let drawn: Vec<_> = drawn.collect();
        assert!(drawn.windows(2).all(|pair| pair[0] == pair[1]));
    }
}

/// A grey picture into a coloured one has no colour; maps that are no maps draw something, and nothing breaks.
#[test]
fn nonsense_is_drawn_without_harm() {
    let matrix = |m: [f64; 9]| OutputMap::Projective(Homography(nalgebra::Matrix3::from_row_slice(&m)));
    let maps = [
        matrix([f64::NAN; 9]),
        matrix([0.0; 9]),
        matrix([1e300, 0.0, 5.0, 0.0, 1e300, 5.0, 0.0, 0.0, 1.0]),
        matrix([1.0, 0.0, f64::INFINITY, 0.0, 1.0, f64::NEG_INFINITY, 0.0, 0.0, 1.0]),
        matrix([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.1, -0.2, 1.0]),
        matrix([40000.0, 0.0, 0.0, 0.0, -40000.0, 0.0, 0.0, 0.0, 1.0]),
        OutputMap::Rows {
            window: Homography::IDENTITY,
            view: Homography::IDENTITY,
            camera: Pinhole::default(),
            kept: 0.0,
            rows: RowPoses { samples: [Pose([f64::NAN, 1e9, -1e9, f64::INFINITY]); RowPoses::SAMPLES], spacing: 0.0 },
        },
    ];
    for [width, height] in [[1, 1], [17, 9], [33, 31]] {
        for (i, map) in maps.iter().enumerate() {
            for level in Level::all() {
                let picture = noise(Sampling::S420, width, height);
                let mut drawn = Picture::new(Sampling::S420, width, height);
                Warper::new(&LINEAR, level, Siting::Centre).draw(map, picture.as_ref(), &mut drawn.as_mut());
                let grey = noise(Sampling::Mono, height, width);
                Warper::new(&LINEAR, level, Siting::Centre).draw(map, grey.as_ref(), &mut drawn.as_mut());
                let neutral = |plane: &PlaneRef<'_>| (0..plane.height()).all(|y| plane.row(y).iter().all(|&c| c == 128));
                assert!(drawn.as_ref().planes[1..].iter().all(neutral), "map {i}");
            }
        }
    }
}

/// Where a map reaches beyond the picture: its mirror image, black, or never anything but the picture.
#[test]
fn the_border_shows_what_it_is_told() {
    let (width, height) = (64, 48);
    let picture = noise(Sampling::S420, width, height);
    let shifted = |border, by: [f64; 2]| {
        let mut drawn = Picture::new(Sampling::S420, width, height);
        let mut warper = Warper::new(&LINEAR, Level::detected(), Siting::Centre);
        warper.set_border(border);
        let map = Homography(nalgebra::Matrix3::new(1.0, 0.0, by[0], 0.0, 1.0, by[1], 0.0, 0.0, 1.0));
        warper.draw(&OutputMap::Projective(map), picture.as_ref(), &mut drawn.as_mut());
        drawn
    };
    // twelve columns and ten rows beyond the left and the upper edge
    let [mirror, black] = [Border::Mirror, Border::Black].map(|border| shifted(border, [-12.0, -10.0]));
    let luma = |picture: &Picture, x: usize, y: usize| picture.luma().row(y)[x];
    for y in 0..height {
        for x in 0..width {
            let (from_x, from_y) = (x.abs_diff(12), y.abs_diff(10));
            assert_eq!(luma(&mirror, x, y), luma(&picture, from_x, from_y), "mirrored at {x}, {y}");
            let seen = if x < 12 || y < 10 { 16 } else { luma(&picture, from_x, from_y) };
            assert_eq!(luma(&black, x, y), seen, "black at {x}, {y}");
        }
    }
    let colour = black.as_ref().planes[1];
    assert!((0..5).all(|y| colour.row(y).iter().all(|&c| c == 128)) && colour.row(0).len() == width / 2);
}

/// An output of another shape has bars, and they are black.
#[test]
fn bars_beside_the_picture_are_black() {
    let (mut picture, mut drawn) = (Picture::new(Sampling::S420, 64, 48), Picture::new(Sampling::S420, 128, 48));
    picture.as_mut().planes[0].fill(200);
    let window = crate::stage::crop::Window::new(&crate::stage::crop::Params::default(), [64, 48], [128, 48]);
    Warper::new(&LINEAR, Level::detected(), Siting::Left).draw(
        &OutputMap::Projective(window.view()),
        picture.as_ref(),
        &mut drawn.as_mut(),
    );
    let row = drawn.luma().row(24).to_vec();
    assert!(row[..26].iter().chain(&row[102..]).all(|&luma| luma == 16), "{row:?}");
    assert!(row[32..96].iter().all(|&luma| luma == 200), "{row:?}");
}
