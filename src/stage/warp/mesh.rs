//! A map as the kernel takes it to find a mesh's nodes.

use crate::geometry::{Homography, OutputMap, RowPoses};
use crate::kernel::warp::{Lens, Mesh, RowTable};

const STRETCHES: usize = RowPoses::SAMPLES - 1;

/// The mesh of `map`: the same but for what single precision makes of the motion within a frame, of a hundred pixels some
/// hundred-thousandths.
pub(super) fn mesh(map: &OutputMap) -> Mesh {
    let entries = |h: &Homography| std::array::from_fn(|i| h.0[(i / 3, i % 3)]);
    let (view, lens, rows) = match map {
        OutputMap::Projective(view) => (view, None, None),
        OutputMap::Rows { window, view, camera, kept, rows } => {
            let samples = &rows.samples;
            let table = |of: &dyn Fn(usize, usize) -> f64| {
                let mut table = [[0.0; _]; 4];
                for (c, channel) in table.iter_mut().enumerate() {
                    channel[..STRETCHES].iter_mut().enumerate().for_each(|(i, value)| *value = of(i, c) as f32);
                }
                table
            };
            let rows = RowTable {
                base: table(&|i, c| samples[i][c]),
                growth: table(&|i, c| samples[i + 1][c] - samples[i][c]),
                stretches: STRETCHES,
                per_row: (1.0 / rows.spacing) as f32,
                focal: camera.focal as f32,
                centre: camera.centre.map(|c| c as f32),
                bend: camera.bend as f32,
            };
            let lens = Lens { window: entries(window), centre: camera.centre, bend: camera.bend, kept: *kept };
            (view, (camera.bend != 0.0).then_some(lens), Some(rows))
        }
    };
    Mesh { view: entries(view), lens, rows }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Pinhole, Pose};
    use crate::kernel::{Level, warp};

    #[test]
    fn its_nodes_are_where_the_map_says() {
        let camera = Pinhole::new([1920, 1080], 70.0);
        let samples = std::array::from_fn(|i| {
            let t = i as f64 / 24.0 - 0.5;
            Pose([0.03 * t, -0.04 * t * t, 0.02 * t, 0.004 * t])
        });
        let view = camera.turned(Pose([0.02, -0.03, 0.05, 0.01]));
        let rows = RowPoses { samples, spacing: 1079.0 / 24.0 };
        let window = Homography(nalgebra::Matrix3::new(0.9, 0.0, 96.0, 0.0, 0.9, 54.0, 0.0, 0.0, 1.0));
        let lens = camera.with_lens(-0.15, 1920);
        for map in [
            OutputMap::Projective(view),
            OutputMap::Rows { window, view, camera, kept: 0.0, rows },
            OutputMap::Rows { window, view, camera: lens, kept: lens.bend, rows },
            OutputMap::Rows { window, view, camera: lens, kept: 0.3 * lens.bend, rows },
        ] {
            let mesh = mesh(&map);
            let mut most = 0.0f64;
            for y in (0..1100).step_by(13) {
                let (mut xs, mut ys) = ([0; 61], [0; 61]);
                warp::nodes(Level::detected(), &mesh, f64::from(y), 5, &mut xs, &mut ys);
                for (i, (x, y_found)) in xs.into_iter().zip(ys).enumerate() {
                    let exact = map.apply([32.0 * i as f64, f64::from(y)]);
                    let found = [x, y_found].map(|c| f64::from(c) / f64::from(warp::ONE));
                    most = most.max((exact[0] - found[0]).hypot(exact[1] - found[1]));
                }
            }
            assert!(most < 2e-4, "{most} px");
        }
    }
}
