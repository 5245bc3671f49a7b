//! A picture: luma and two chroma planes, the one form in which frames travel inside gimbald.

use super::{BLACK, Plane, PlaneMut, PlaneRef};

/// How many chroma samples a picture has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Sampling {
    /// Luma alone.
    Mono,
    /// 4:2:0: one chroma sample to two by two luma samples.
    #[default]
    S420,
    /// 4:2:2: one to two in a row.
    S422,
    /// 4:4:4: one to one.
    S444,
}

impl Sampling {
    /// Luma samples to a chroma sample, as powers of two (x, y); `None` for [`Sampling::Mono`].
    pub fn shift(self) -> Option<(u32, u32)> {
        match self {
            Self::Mono => None,
            Self::S420 => Some((1, 1)),
            Self::S422 => Some((1, 0)),
            Self::S444 => Some((0, 0)),
        }
    }

    /// Size of a chroma plane (width, height) of a picture of `width` x `height`; (0, 0) for [`Sampling::Mono`].
    pub fn chroma_size(self, width: usize, height: usize) -> (usize, usize) {
        match self.shift() {
            None => (0, 0),
            Some((x, y)) => (width.div_ceil(1 << x), height.div_ceil(1 << y)),
        }
    }
}

/// An owned planar picture, 8 bits a sample: BT.601, limited range, as [`Colour::inside`](super::Colour::inside) says.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Picture {
    sampling: Sampling,
    y: Plane,
    u: Plane,
    v: Plane,
}

impl Picture {
    /// A picture of `width` x `height` luma samples, all zero.
    pub fn new(sampling: Sampling, width: usize, height: usize) -> Self {
        let mut picture = Self::default();
        picture.reshape(sampling, width, height);
        picture
    }

    /// Gives the picture another shape, keeping its memory where that is large enough; the samples are then unspecified.
    pub fn reshape(&mut self, sampling: Sampling, width: usize, height: usize) {
        let (cw, ch) = sampling.chroma_size(width, height);
        self.sampling = sampling;
        self.y.reshape(width, height);
        self.u.reshape(cw, ch);
        self.v.reshape(cw, ch);
    }

    /// Luma samples in a row.
    pub fn width(&self) -> usize {
        self.y.width()
    }

    /// Luma rows.
    pub fn height(&self) -> usize {
        self.y.height()
    }

    /// How many chroma samples there are.
    pub fn sampling(&self) -> Sampling {
        self.sampling
    }

    /// The luma plane.
    pub fn luma(&self) -> PlaneRef<'_> {
        self.y.as_ref()
    }

    /// Lends the picture, read-only.
    pub fn as_ref(&self) -> PictureRef<'_> {
        PictureRef { sampling: self.sampling, planes: [self.y.as_ref(), self.u.as_ref(), self.v.as_ref()] }
    }

    /// Lends the picture, to write.
    pub fn as_mut(&mut self) -> PictureMut<'_> {
        PictureMut { sampling: self.sampling, planes: [self.y.as_mut(), self.u.as_mut(), self.v.as_mut()] }
    }
}

/// A lent, read-only picture: planes Y, U, V (U and V empty for [`Sampling::Mono`]).
#[derive(Clone, Copy, Debug)]
pub struct PictureRef<'a> {
    /// How many chroma samples there are.
    pub sampling: Sampling,
    /// Y, U, V.
    pub planes: [PlaneRef<'a>; 3],
}

impl PictureRef<'_> {
    /// Luma samples in a row.
    pub fn width(&self) -> usize {
        self.planes[0].width()
    }

    /// Luma rows.
    pub fn height(&self) -> usize {
        self.planes[0].height()
    }
}

/// A lent, writable picture: planes Y, U, V (U and V empty for [`Sampling::Mono`]).
#[derive(Debug)]
pub struct PictureMut<'a> {
    /// How many chroma samples there are.
    pub sampling: Sampling,
    /// Y, U, V.
    pub planes: [PlaneMut<'a>; 3],
}

impl PictureMut<'_> {
    /// Luma samples in a row.
    pub fn width(&self) -> usize {
        self.planes[0].width()
    }

    /// Luma rows.
    pub fn height(&self) -> usize {
        self.planes[0].height()
    }

    /// Makes the picture black.
    pub fn blacken(&mut self) {
        let [y, u, v] = &mut self.planes;
        y.fill(BLACK[0]);
        u.fill(BLACK[1]);
        v.fill(BLACK[1]);
    }

    /// The same picture, read-only.
    pub fn as_ref(&self) -> PictureRef<'_> {
        PictureRef { sampling: self.sampling, planes: self.planes.each_ref().map(PlaneMut::as_ref) }
    }

    /// The same picture, lent on for a shorter time.
    pub fn reborrow(&mut self) -> PictureMut<'_> {
        PictureMut { sampling: self.sampling, planes: self.planes.each_mut().map(PlaneMut::reborrow) }
    }
}
