//! A plane: a rectangle of samples in memory, owned or lent.

/// A lent, read-only rectangle of samples, row-major, `stride` samples from one row's start to the next's.
#[derive(Clone, Copy, Debug)]
pub struct PlaneRef<'a, T = u8> {
    data: &'a [T],
    width: usize,
    height: usize,
    stride: usize,
}

impl<'a, T: Copy> PlaneRef<'a, T> {
    /// Wraps `data` as `height` rows of `width` samples. `None` where `data` is too short or a row longer than the stride.
    pub fn new(data: &'a [T], width: usize, height: usize, stride: usize) -> Option<Self> {
        fits(data.len(), width, height, stride).then_some(Self { data, width, height, stride })
    }

    /// Samples in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Samples from one row's start to the next's.
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// The samples of row `y`.
    #[inline]
    pub fn row(&self, y: usize) -> &'a [T] {
        &self.data[y * self.stride..][..self.width]
    }

    /// Every sample from the first row's start on, padding between rows included.
    pub fn samples(&self) -> &'a [T] {
        self.data
    }

    /// The sample at column `x` of row `y`.
    #[inline]
    pub fn at(&self, x: usize, y: usize) -> T {
        self.row(y)[x]
    }
}

/// A lent, writable rectangle of samples; shape as [`PlaneRef`].
#[derive(Debug)]
pub struct PlaneMut<'a, T = u8> {
    data: &'a mut [T],
    width: usize,
    height: usize,
    stride: usize,
}

impl<'a, T: Copy> PlaneMut<'a, T> {
    /// Wraps `data` as `height` rows of `width` samples. `None` where `data` is too short or a row longer than the stride.
    pub fn new(data: &'a mut [T], width: usize, height: usize, stride: usize) -> Option<Self> {
        fits(data.len(), width, height, stride).then_some(Self { data, width, height, stride })
    }

    /// Samples in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Samples from one row's start to the next's.
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// The samples of row `y`, to write.
    #[inline]
    pub fn row_mut(&mut self, y: usize) -> &mut [T] {
        &mut self.data[y * self.stride..][..self.width]
    }

    /// The same plane, read-only.
    pub fn as_ref(&self) -> PlaneRef<'_, T> {
        PlaneRef { data: self.data, width: self.width, height: self.height, stride: self.stride }
    }

    /// The same plane, lent on for a shorter time.
    pub fn reborrow(&mut self) -> PlaneMut<'_, T> {
        PlaneMut { data: self.data, width: self.width, height: self.height, stride: self.stride }
    }

    /// Copies `from`, row by row, as far as both reach.
    pub fn copy_from(&mut self, from: PlaneRef<'_, T>) {
        let width = self.width.min(from.width);
        for y in 0..self.height.min(from.height) {
            self.row_mut(y)[..width].copy_from_slice(&from.row(y)[..width]);
        }
    }

    /// Sets every sample to `value`.
    pub fn fill(&mut self, value: T) {
        for y in 0..self.height {
            self.row_mut(y).fill(value);
        }
    }
}

/// An owned plane without padding between rows.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Plane<T = u8> {
    data: Vec<T>,
    width: usize,
    height: usize,
}

impl<T: Copy + Default> Plane<T> {
    /// A plane of `height` rows of `width` default samples.
    pub fn new(width: usize, height: usize) -> Self {
        Self { data: vec![T::default(); width * height], width, height }
    }

    /// Gives the plane another shape. Keeps its memory where that is large enough; the samples are then unspecified.
    pub fn reshape(&mut self, width: usize, height: usize) {
        self.data.resize(width * height, T::default());
        self.width = width;
        self.height = height;
    }

    /// Samples in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The samples of row `y`.
    #[inline]
    pub fn row(&self, y: usize) -> &[T] {
        &self.data[y * self.width..][..self.width]
    }

    /// The samples of row `y`, to write.
    #[inline]
    pub fn row_mut(&mut self, y: usize) -> &mut [T] {
        &mut self.data[y * self.width..][..self.width]
    }

    /// Lends the plane, read-only.
    pub fn as_ref(&self) -> PlaneRef<'_, T> {
        PlaneRef { data: &self.data, width: self.width, height: self.height, stride: self.width }
    }

    /// Lends the plane, to write.
    pub fn as_mut(&mut self) -> PlaneMut<'_, T> {
        PlaneMut { data: &mut self.data, width: self.width, height: self.height, stride: self.width }
    }

    /// Every sample, row-major without padding.
    pub fn samples(&self) -> &[T] {
        &self.data
    }

    /// Every sample, row-major without padding, to write.
    pub fn samples_mut(&mut self) -> &mut [T] {
        &mut self.data
    }
}

/// Whether `len` samples hold `height` rows of `width`, `stride` apart (the last row needs no padding).
fn fits(len: usize, width: usize, height: usize, stride: usize) -> bool {
    if height == 0 || width == 0 {
        return true;
    }
    width <= stride && (height - 1).checked_mul(stride).and_then(|n| n.checked_add(width)).is_some_and(|need| need <= len)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_refuses_memory_that_is_too_short() {
        let data = [0u8; 10];
        assert!(PlaneRef::new(&data, 4, 2, 6).is_some(), "the last row needs no padding");
        assert!(PlaneRef::new(&data, 4, 3, 4).is_none());
        assert!(PlaneRef::new(&data, 7, 1, 6).is_none(), "a row longer than the stride");
        assert!(PlaneRef::new(&data, usize::MAX, 2, usize::MAX).is_none());
    }

    #[test]
    fn copying_takes_what_both_have() {
        let mut to = Plane::<u8>::new(3, 2);
        let from = [1u8, 2, 3, 4, 5, 6, 7, 8];
        to.as_mut().copy_from(PlaneRef::new(&from, 2, 2, 4).unwrap());
        assert_eq!(to.samples(), &[1, 2, 0, 5, 6, 0]);
    }
}
