//! Parameters as PipeWire's plugin interface writes them (SPA "pods"): objects of typed properties, in native byte order.

/// `enum spa_param_type`.
pub(super) const PARAM_ENUM_FORMAT: u32 = 3;
pub(super) const PARAM_FORMAT: u32 = 4;
const PARAM_BUFFERS: u32 = 5;
const PARAM_META: u32 = 6;

/// Types of values, as spa/utils/type.h numbers them.
const ID: u32 = 3;
const INT: u32 = 4;
const RECTANGLE: u32 = 10;
const FRACTION: u32 = 11;
const OBJECT: u32 = 15;
const CHOICE: u32 = 19;
const OBJECT_FORMAT: u32 = 0x4_0003;
const OBJECT_BUFFERS: u32 = 0x4_0004;
const OBJECT_META: u32 = 0x4_0005;

/// `enum spa_choice_type`: default, least, most; and a set of bits.
const CHOICE_RANGE: u32 = 1;
const CHOICE_FLAGS: u32 = 4;

/// Video, raw, YUY2 (which V4L2 calls YUYV).
const MEDIA_VIDEO: u32 = 2;
const MEDIA_RAW: u32 = 1;
const VIDEO_YUY2: u32 = 4;

/// An object in the making; its bytes are aligned to eight, as the library reads them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Pod(Vec<u64>);

struct Builder(Vec<u32>);

impl Builder {
    fn object(kind: u32, id: u32) -> Self {
        // The size is filled in at the end.
        Self(vec![0, OBJECT, kind, id])
    }

    /// A property with one value of `kind`, one or two words long.
    fn property(mut self, key: u32, kind: u32, value: &[u32]) -> Self {
        self.0.extend([key, 0, 4 * value.len() as u32, kind]);
        self.0.extend_from_slice(value);
        self.pad()
    }

    /// A property that leaves a choice among whole numbers.
    fn choice(mut self, key: u32, choice: u32, values: &[u32]) -> Self {
        self.0.extend([key, 0, 16 + 4 * values.len() as u32, CHOICE, choice, 0, 4, INT]);
        self.0.extend_from_slice(values);
        self.pad()
    }

    fn pad(mut self) -> Self {
        self.0.resize(self.0.len().next_multiple_of(2), 0);
        self
    }

    fn done(mut self) -> Pod {
        self.0[0] = 4 * (self.0.len() as u32 - 2);
        let word = |pair: &[u32]| {
            let (first, second) = (pair[0].to_ne_bytes(), pair[1].to_ne_bytes());
            u64::from_ne_bytes(std::array::from_fn(|i| if i < 4 { first[i] } else { second[i - 4] }))
        };
        Pod(self.0.chunks_exact(2).map(word).collect())
    }
}

impl Pod {
    /// Where it lies, for the library; valid as long as this is.
    pub(super) fn as_ptr(&self) -> *const std::ffi::c_void {
        self.0.as_ptr().cast()
    }
}

/// The one format of a node: YUY2 of `width` x `height`, `rate` frames a second (numerator, denominator).
pub(super) fn format(width: u32, height: u32, rate: (u32, u32)) -> Pod {
    Builder::object(OBJECT_FORMAT, PARAM_ENUM_FORMAT)
        .property(1, ID, &[MEDIA_VIDEO])
        .property(2, ID, &[MEDIA_RAW])
        .property(0x2_0001, ID, &[VIDEO_YUY2])
        .property(0x2_0003, RECTANGLE, &[width, height])
        .property(0x2_0004, FRACTION, &[rate.0, rate.1])
        .done()
}

/// How many buffers, of one block of `size` bytes with rows `stride` bytes apart, behind a descriptor.
pub(super) fn buffers(count: std::ops::RangeInclusive<u32>, size: u32, stride: u32) -> Pod {
    let (least, most) = (*count.start(), *count.end());
    Builder::object(OBJECT_BUFFERS, PARAM_BUFFERS)
        .choice(1, CHOICE_RANGE, &[least, least, most])
        .property(2, INT, &[1])
        .property(3, INT, &[size])
        .property(4, INT, &[stride])
        .choice(6, CHOICE_FLAGS, &[1 << super::layout::DATA_MEM_FD])
        .done()
}

/// That buffers have a piece of metadata of that kind and size.
pub(super) fn meta(kind: u32, size: usize) -> Pod {
    Builder::object(OBJECT_META, PARAM_META).property(1, ID, &[kind]).property(2, INT, &[size as u32]).done()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(pod: &Pod) -> Vec<u32> {
        pod.0.iter().flat_map(|word| [*word as u32, (*word >> 32) as u32]).collect()
    }

    #[test]
    fn values_lie_where_the_headers_put_them() {
        // As `pw-dump` prints them and `spa_debug_mem` shows them: size, type, then properties of key, flags, size, type, value, padding.
        let words = words(&format(1280, 720, (30, 1)));
        assert_eq!(words[..4], [words.len() as u32 * 4 - 8, 15, 0x4_0003, 3]);
        assert_eq!(words[4..10], [1, 0, 4, 3, 2, 0]);
        assert_eq!(words[words.len() - 12..], [0x2_0003, 0, 8, 10, 1280, 720, 0x2_0004, 0, 8, 11, 30, 1]);
    }

    #[test]
    fn choices_carry_their_kind_and_values() {
        let words = words(&buffers(8..=16, 100, 10));
        assert_eq!(words[4..16], [1, 0, 28, 19, 1, 0, 4, 4, 8, 8, 16, 0]);
        assert_eq!(words[0] as usize, words.len() * 4 - 8);
    }
}
