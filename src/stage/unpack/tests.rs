//! Unpacking checked.
