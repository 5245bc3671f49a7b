//! The version of v4l2loopback, which decides what the module can do.

use crate::device::version::major_minor;

/// Where a loaded module says its version; modules before 0.13 do not.
pub(super) const FILE: &str = "/sys/module/v4l2loopback/version";

/// Major and minor version number; (0, 0) where the module does not say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct LoopbackVersion(pub u32, pub u32);

impl LoopbackVersion {
    /// The first version that reports viewers.
    pub const REPORTS_VIEWERS: Self = Self(0, 13);
    /// The first version that gives the writer any free buffer, instead of each in turn.
    pub const ANY_BUFFER: Self = Self(0, 15);

    /// The version in a text like "0.12.7".
    pub fn parse(text: &str) -> Self {
        let (major, minor) = major_minor(text);
        Self(major, minor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_compared_by_their_numbers() {
        let old = ["0.12.7", "0.13.2\n", "0.15.0\n", "0.15.4", "1.0.0", "", "0.9"]
            .map(|text| LoopbackVersion::parse(text) < LoopbackVersion::ANY_BUFFER);
        assert_eq!(old, [true, true, false, false, false, true, true]);
        assert!(LoopbackVersion::parse("0.12.7") < LoopbackVersion::REPORTS_VIEWERS);
        assert!(LoopbackVersion::parse("0.13") >= LoopbackVersion::REPORTS_VIEWERS);
    }
}
