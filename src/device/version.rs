//! Version numbers of other programs and of modules.

/// The first two numbers of a version such as "0.12.7", "5.1.6-0+deb12u1" or "0.13.2\n"; 0 for what is missing.
pub(super) fn major_minor(text: &str) -> (u32, u32) {
    let mut numbers = text.split(|c: char| !c.is_ascii_digit()).map(|number| number.parse().unwrap_or(0));
    (numbers.next().unwrap_or(0), numbers.next().unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_two_numbers_are_read() {
        for (text, wanted) in [
            ("0.12.7", (0, 12)),
            ("5.1.6-0+deb12u1", (5, 1)),
            ("0.13.2\n", (0, 13)),
            ("7", (7, 0)),
            ("", (0, 0)),
            ("x.4", (0, 0)),
        ] {
            assert_eq!(major_minor(text), wanted, "{text:?}");
        }
    }
}
