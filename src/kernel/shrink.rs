//! Pictures made smaller by whole numbers: each sample is the mean of a box of samples.

use std::ops::Range;

use crate::image::{PlaneMut, PlaneRef};

/// Writes into rows `rows` of `into` the means of `from`'s boxes of `across` x `down` samples, rounded, halves up, as far as both reach.
/// Both factors are at least 1 and at most 256.
pub fn boxes(from: PlaneRef<'_>, (across, down): (usize, usize), into: &mut PlaneMut<'_>, rows: Range<usize>) {
    let (across, down) = (across.clamp(1, 256), down.clamp(1, 256));
    let columns = (from.width() / across).min(into.width());
    let count = (across * down) as u32;
    let rows = rows.start..rows.end.min(into.height());
    for (y, row) in rows.enumerate() {
        if (y + 1) * down > from.height() {
            return;
        }
        let out = &mut into.row_mut(row)[..columns];
        if count == 1 {
            out.copy_from_slice(&from.row(y)[..columns]);
            continue;
        }
        for (x, sample) in out.iter_mut().enumerate() {
            let line = |line: usize| &from.row(y * down + line)[x * across..][..across];
            let sum: u32 = (0..down).flat_map(line).map(|sample| u32::from(*sample)).sum();
            *sample = ((sum + count / 2) / count) as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Plane;

    #[test]
    fn means_of_boxes_and_what_does_not_fit_stays() {
        let samples: Vec<u8> = (0..35).collect();
        let from = PlaneRef::new(&samples, 7, 5, 7).unwrap();
        let mut into: Plane = Plane::new(4, 6);
        into.as_mut().fill(99);
        boxes(from, (2, 2), &mut into.as_mut(), 1..6);
        // 0 1 7 8: 4; 2 3 9 10: 6
        assert_eq!((into.row(0), into.row(1)), (&[99; 4][..], &[4, 6, 8, 99][..]));
        assert_eq!((into.row(2), into.row(3)), (&[18, 20, 22, 99][..], &[99; 4][..]));
        boxes(from, (1, 1), &mut into.as_mut(), 0..1);
        assert_eq!(into.row(0), [0, 1, 2, 3]);
        boxes(from, (300, 0), &mut into.as_mut(), 0..6);
        assert_eq!(into.row(0), [0, 1, 2, 3], "wider than the picture");
    }
}
