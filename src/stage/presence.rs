//! What is switched on and off while running, stabilization or the straightening of lines, fades in and out, with no edge at either end.

/// Seconds in which all of it comes or goes.
const FADE_S: f64 = 1.0;

/// The part that is shown.
#[derive(Clone, Copy, Debug)]
pub struct Presence {
    level: f64,
    on: bool,
}

impl Presence {
    /// All of it where it is `on`, else none.
    pub fn new(on: bool) -> Self {
        Self { level: if on { 1.0 } else { 0.0 }, on }
    }

    /// Switches; what changes fades.
    pub fn switch(&mut self, on: bool) {
        self.on = on;
    }

    /// The part (0 to 1) after `interval_s` seconds.
    pub fn step(&mut self, interval_s: f64) -> f64 {
        let way = interval_s / FADE_S;
        self.level = (self.level + if self.on { way } else { -way }).clamp(0.0, 1.0);
        self.level * self.level * (3.0 - 2.0 * self.level)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_fades_both_ways_and_arrives() {
        for rate in [15.0, 30.0, 60.0] {
            let mut presence = Presence::new(true);
            assert_eq!(presence.step(1.0 / rate), 1.0);
            presence.switch(false);
            let mut before = 1.0;
            for frame in 0..rate as usize + 1 {
                // in the middle of a fade it may be switched back, too
                presence.switch(frame == 3);
                let now = presence.step(1.0 / rate);
                assert!((before - now).abs() <= 1.5 / rate + 1e-9, "{rate} fps: {before} {now}");
                before = now;
            }
            presence.switch(false);
            (0..4).for_each(|_| before = presence.step(1.0 / rate));
            assert_eq!(before, 0.0);
            presence.switch(true);
            (0..=rate as usize).for_each(|_| before = presence.step(1.0 / rate));
            assert_eq!(before, 1.0);
        }
    }
}
