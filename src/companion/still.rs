//! The picture that viewers see while the daemon sends none: the last one, or the placeholder.

use crate::device::placeholder;
use crate::image::{Picture, Sampling};
use crate::kernel::{Level, convert::pack};
use crate::pipewire::{NodeParams, Slot};
use crate::share::{Memory, PIXEL};

/// The still picture of one node.
#[derive(Debug)]
pub(super) struct Still {
    size: (u32, u32),
    stride: usize,
    bytes: usize,
    /// The dark picture, once it was needed.
    dark: Vec<u8>,
    /// The buffer that was sent last: it is not drawn into before another was sent.
    last: Option<Slot>,
}

impl Still {
    pub(super) fn new(params: &NodeParams) -> Self {
        let (size, stride, bytes) = ((params.width, params.height), params.stride(), params.bytes());
        Self { size, stride, bytes, dark: Vec::new(), last: None }
    }

    /// That buffer was sent.
    pub(super) fn sent(&mut self, slot: &Slot) {
        self.last = Some(slot.clone());
    }

    /// The last picture is not shown again: a program that watches later does not see it.
    pub(super) fn forget(&mut self) {
        self.last = None;
    }

    /// Draws the last picture into `slot`, or the dark one if `dark` or there was none; says whether that worked.
    pub(super) fn draw(&mut self, slot: &Slot, dark: bool) -> bool {
        let last = self.last.as_ref().filter(|_| !dark);
        if last.is_some_and(|last| last.id == slot.id) {
            return true;
        }
        let Ok(mut to) = Memory::map(&*slot.fd, self.bytes) else { return false };
        match last.and_then(|last| Memory::map(&*last.fd, self.bytes).ok()) {
            Some(from) => to.bytes_mut().copy_from_slice(from.bytes()),
            None => to.bytes_mut().copy_from_slice(self.dark()),
        }
        true
    }

    fn dark(&mut self) -> &[u8] {
        if self.dark.is_empty() {
            let mut picture = Picture::new(Sampling::S420, self.size.0 as usize, self.size.1 as usize);
            placeholder::draw(&mut picture.as_mut());
            self.dark = vec![0; self.bytes];
            // The sizes are right by construction; if they were not, the picture would be green, and no more.
            let _ = pack(Level::detected(), picture.as_ref(), PIXEL, self.stride, &mut self.dark);
        }
        &self.dark
    }
}
