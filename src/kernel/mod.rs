//! Pixel loops and the equations of the camera's motion (`normal`, `dense`): the one place with SIMD. Scalar code defines the result, every other
//! variant gives the same bits.
//!
//! Most kernels here are plain loops that the compiler vectorizes by itself once it may use wider registers; [`dispatch!`]
//! compiles such a body twice and picks one at run time. Where a hand-written variant pays, it stands beside its scalar form.

pub(crate) mod cache;
pub mod convert;
pub mod corner;
pub(crate) mod dense;
pub mod lk;
pub(crate) mod normal;
pub mod pyramid;
pub(crate) mod shrink;
pub mod warp;

use std::sync::OnceLock;

/// The name of the environment variable that caps [`Level::detected`] by a level's name: on x86-64 `scalar` or `avx2`, on aarch64 `scalar`
/// or `neon`, elsewhere `scalar`. Empty, it says nothing.
pub const LEVEL_VARIABLE: &str = "GIMBALD_SIMD";

/// An instruction set that this processor has: holding the value is the proof. Kernels take it as an argument.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Level(Set);

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Set {
    Scalar,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "aarch64")]
    Neon,
}

impl Set {
    /// Every level that this architecture can have, the scalar one first.
    const ALL: &[Self] = &[
        Self::Scalar,
        #[cfg(target_arch = "x86_64")]
        Self::Avx2,
        #[cfg(target_arch = "aarch64")]
        Self::Neon,
    ];
}

impl Level {
    /// The plain loops, which every processor can run.
    pub const SCALAR: Self = Self(Set::Scalar);

    /// The best level of this processor, capped by [`LEVEL_VARIABLE`] (an unknown word there caps nothing). Found, and told of in
    /// the log, once.
    pub fn detected() -> Self {
        static FOUND: OnceLock<Level> = OnceLock::new();
        *FOUND.get_or_init(|| {
            let level = Self::capped(std::env::var(LEVEL_VARIABLE).ok().as_deref());
            tracing::info!(simd = level.name(), best = Self::best().name(), "pixel loops");
            level
        })
    }

    /// Whether [`LEVEL_VARIABLE`] says something that is known, or nothing.
    ///
    /// # Errors
    /// What it says, and what it may say.
    pub fn check_cap() -> Result<(), String> {
        let word = std::env::var_os(LEVEL_VARIABLE).unwrap_or_default();
        let known: Vec<&str> = Set::ALL.iter().map(|set| Self(*set).name()).collect();
        if word.is_empty() || known.iter().any(|name| word == *name) {
            return Ok(());
        }
        Err(format!("{LEVEL_VARIABLE}={}: expected one of {}; or unset it", word.to_string_lossy(), known.join(", ")))
    }

    /// The best level of this processor that `cap` allows.
    fn capped(cap: Option<&str>) -> Self {
        if cap == Some(Self::SCALAR.name()) {
            return Self::SCALAR;
        }
        Self::best()
    }

    /// The best level of this processor.
    pub fn best() -> Self {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            return Self(Set::Avx2);
        }
        // The compiler has been told of it for the whole program.
        #[cfg(target_arch = "aarch64")]
        return Self(Set::Neon);
        #[cfg(not(target_arch = "aarch64"))]
        Self::SCALAR
    }

    /// Every level of this processor, the scalar one first; for tests that compare them.
    pub fn all() -> impl Iterator<Item = Self> {
        [Self::SCALAR, Self::best()].into_iter().take(if Self::best() == Self::SCALAR { 1 } else { 2 })
    }

    /// Whether AVX2 and FMA may be used.
    #[cfg(target_arch = "x86_64")]
    #[inline]
    pub fn has_avx2(self) -> bool {
        self.0 == Set::Avx2
    }

    /// Whether the loops that are written for NEON may be used. The compiler uses NEON in the plain loops, too.
    #[cfg(target_arch = "aarch64")]
    #[inline]
    pub fn has_neon(self) -> bool {
        self.0 == Set::Neon
    }

    /// The name under which reports show it.
    pub fn name(self) -> &'static str {
        match self.0 {
            Set::Scalar => "scalar",
            #[cfg(target_arch = "x86_64")]
            Set::Avx2 => "avx2",
            #[cfg(target_arch = "aarch64")]
            Set::Neon => "neon",
        }
    }
}

/// `dispatch!(level, body(arg: Type, ...) -> Type)` calls the `#[inline(always)]` function `body`, compiled once for any
/// processor and once for AVX2 with FMA, whichever `level` says. Rust never contracts a product and a sum by itself, so both give
/// the same bits. To be the last expression of its function.
///
/// A body that is generic over a constant says so: `dispatch!(level, [const N: usize] body::<N>(arg: Type, ...))`.
macro_rules! dispatch {
    ($level:expr, [const $name:ident: $kind:ty] $body:ident::<$same:ident>($($arg:ident: $type:ty),* $(,)?) $(-> $result:ty)?) => {{
        #[cfg(target_arch = "x86_64")]
        if $level.has_avx2() {
            #[target_feature(enable = "avx2,fma")]
            fn avx2<const $name: $kind>($($arg: $type),*) $(-> $result)? {
                $body::<$name>($($arg),*)
            }
            // SAFETY: a `Level` says AVX2 only where the processor was found to have AVX2 and FMA.
            return unsafe { avx2::<$same>($($arg),*) };
        }
        #[cfg(not(target_arch = "x86_64"))]
        let _ = $level;
        $body::<$same>($($arg),*)
    }};
    ($level:expr, $body:ident $(::<$generic:tt>)? ($($arg:ident: $type:ty),* $(,)?) $(-> $result:ty)?) => {{
        #[cfg(target_arch = "x86_64")]
        if $level.has_avx2() {
            #[target_feature(enable = "avx2,fma")]
            fn avx2($($arg: $type),*) $(-> $result)? {
                $body $(::<$generic>)? ($($arg),*)
            }
            // SAFETY: a `Level` says AVX2 only where the processor was found to have AVX2 and FMA.
            return unsafe { avx2($($arg),*) };
        }
        #[cfg(not(target_arch = "x86_64"))]
        let _ = $level;
        $body $(::<$generic>)? ($($arg),*)
    }};
}
pub(crate) use dispatch;

#[cfg(test)]
mod tests;
