//! Chooses which of a camera's nodes to stream from: the one that provides the requested mode, in colour before grey.
//!
//! The first node is not always the one with the picture: some cameras begin with one that gives H.264 only, laptops with the
//! infrared camera that recognizes faces.

use std::path::PathBuf;

use super::super::DeviceError;
use super::capture::Avoided;
use super::mode::{Mode, Wish, choose};
use super::negotiate::{check_camera, modes, unsupported};
use super::node::Node;
use crate::image::PixelFormat;

/// What a node's formats are good for, best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Use {
    Colour,
    Grey,
    /// It gives what gimbald can read, but nothing that was asked for.
    NotAsked,
    Unreadable,
}

/// What is streamed from.
pub(super) struct Selected {
    pub(super) node: Node,
    pub(super) mode: Mode,
    /// The format to try next, should this one not work; `None` where the node has no other that fits.
    pub(super) next_best: Option<PixelFormat>,
}

/// The best of the nodes at `paths` for what is asked; the first of equals. Formats that the camera is known to be bad at (`avoid`) are
/// left out, as long as there is another.
///
/// # Errors
/// Where none of them serves: why not, of the first that should have.
pub(super) fn best(paths: &[PathBuf], asked: &Wish, avoid: &[Avoided]) -> Result<Selected, DeviceError> {
    let mut best: Option<(Use, Node, Option<Choice>)> = None;
    let mut refused = None;
    for path in paths {
        let opened = Node::open(path).and_then(|node| check_camera(&node).map(|()| node));
        let node = match opened {
            Ok(node) => node,
            Err(error) => {
                refused.get_or_insert(error);
                continue;
            }
        };
        let choice = choice(modes(&node, asked), asked, &avoided(&node, avoid));
        let good_for = Use::of(choice.as_ref(), || !modes(&node, &Wish::default()).is_empty());
        if best.as_ref().is_none_or(|(other, ..)| good_for < *other) {
            best = Some((good_for, node, choice));
        }
        if good_for == Use::Colour {
            break;
        }
    }
    match (best, refused) {
        (Some((_, node, Some((mode, next_best)))), _) => Ok(Selected { node, mode, next_best }),
        (Some((Use::NotAsked, node, _)), _) | (Some((_, node, _)), None) => Err(unsupported(node.path(), asked, &node)),
        (_, Some(error)) => Err(error),
        (None, None) => Err(DeviceError::Gone { path: PathBuf::new() }),
    }
}

/// The formats to be left out for the camera of this node.
fn avoided(node: &Node, avoid: &[Avoided]) -> Vec<PixelFormat> {
    let (card, bus) = node.identity().map_or_else(|_| Default::default(), |identity| (identity.card, identity.bus));
    avoid.iter().filter(|avoid| avoid.is_of(&card, &bus)).map(|avoid| avoid.pixel).collect()
}

/// A mode, and the format to try next.
type Choice = (Mode, Option<PixelFormat>);

/// The choice among what a node offers.
fn choice(mut offered: Vec<Mode>, asked: &Wish, avoid: &[PixelFormat]) -> Option<Choice> {
    let others: Vec<Mode> = offered.iter().filter(|mode| !avoid.contains(&mode.pixel)).copied().collect();
    if asked.format.is_none() && choose(&others, asked).is_some() {
        offered = others;
    }
    let mode = choose(&offered, asked)?;
    offered.retain(|other| other.pixel != mode.pixel);
    Some((mode, choose(&offered, asked).map(|mode| mode.pixel)))
}

impl Use {
    /// What a node is good for, of which this was chosen; `is_readable` is asked only where nothing was.
    fn of(choice: Option<&Choice>, is_readable: impl FnOnce() -> bool) -> Self {
        match choice {
            Some((mode, _)) if mode.pixel == PixelFormat::Grey => Self::Grey,
            Some(_) => Self::Colour,
            None if is_readable() => Self::NotAsked,
            None => Self::Unreadable,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mode(pixel: PixelFormat, width: u32, height: u32) -> Mode {
        Mode { pixel, fourcc: pixel.fourcc(), width, height, interval: (1, 30) }
    }

    #[test]
    fn colour_goes_before_grey_and_both_before_what_was_not_asked() {
        let hd = Wish { width: Some(1280), height: Some(720), ..Wish::default() };
        let any = Wish::default();
        let judged =
            |offered: &[Mode], asked: &Wish| Use::of(choice(offered.to_vec(), asked, &[]).as_ref(), || !offered.is_empty());
        let colour = [mode(PixelFormat::Mjpeg, 1280, 720)];
        let grey = [mode(PixelFormat::Grey, 640, 480)];
        assert!(judged(&colour, &any) < judged(&grey, &any));
        assert_eq!(judged(&grey, &hd), Use::NotAsked, "an infrared camera of another size");
        assert!(judged(&grey, &hd) < judged(&[], &hd), "H.264 alone is nothing to read");
    }

    #[test]
    fn what_does_not_work_is_left_out_while_there_is_another() {
        let offered = vec![mode(PixelFormat::Yuyv, 640, 480), mode(PixelFormat::Mjpeg, 640, 480)];
        let any = Wish::default();
        let chosen = |asked: &Wish, avoid: &[PixelFormat]| {
            let (mode, next) = choice(offered.clone(), asked, avoid).unwrap();
            (mode.pixel, next)
        };
        assert_eq!(chosen(&any, &[]), (PixelFormat::Yuyv, Some(PixelFormat::Mjpeg)));
        assert_eq!(chosen(&any, &[PixelFormat::Yuyv]), (PixelFormat::Mjpeg, None));
        assert_eq!(chosen(&any, &[PixelFormat::Yuyv, PixelFormat::Mjpeg]).0, PixelFormat::Yuyv, "there is no other");
        let yuyv = Wish { format: Some(PixelFormat::Yuyv), ..any };
        assert_eq!(chosen(&yuyv, &[PixelFormat::Yuyv]).0, PixelFormat::Yuyv, "what is asked for is what is given");
    }
}
