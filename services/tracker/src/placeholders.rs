//! Positions that mean "not seen": 0,0 or −1,−1, or any exact position to which detections jump repeatedly.

/// Largest number of remembered positions.
const PLACES_MAX: usize = 8;
/// Number of jumps to an exact position that make it a placeholder.
const JUMPS: u8 = 2;

/// An exact position, as the bits of its coordinates.
type Place = [u32; 2];

/// The positions to which detections have jumped.
#[derive(Clone, Copy, Debug, Default)]
pub struct Placeholders {
    /// Each position with the number of jumps to it.
    places: [Option<(Place, u8)>; PLACES_MAX],
    /// Place of the next write.
    next: usize,
}

impl Placeholders {
    /// Whether a position is known as a placeholder.
    #[must_use]
    pub fn holds(&self, place: Place) -> bool {
        self.places.iter().flatten().any(|(known, jumps)| *known == place && *jumps >= JUMPS)
    }

    /// Records that an agent's detection has jumped to a position, or away from a position at which it always
    /// was. Returns whether the position is a placeholder.
    pub fn add_jump(&mut self, place: Place) -> bool {
        if is_marked(place) {
            self.add(place);
            return true;
        }
        if let Some((_, jumps)) = self.places.iter_mut().flatten().find(|(known, _)| *known == place) {
            *jumps = jumps.saturating_add(1);
            return *jumps >= JUMPS;
        }
        self.write(place, 1);
        false
    }

    /// Adds a placeholder.
    pub fn add(&mut self, place: Place) {
        match self.places.iter_mut().flatten().find(|(known, _)| *known == place) {
            Some((_, jumps)) => *jumps = JUMPS,
            None => self.write(place, JUMPS),
        }
    }

    fn write(&mut self, place: Place, jumps: u8) {
        self.places[self.next] = Some((place, jumps));
        self.next = (self.next + 1) % PLACES_MAX;
    }
}

/// Whether both coordinates are a typical value for "none": 0, 1, −1, or an integer of at least 99 such as
/// −999.
#[must_use]
pub fn is_marked([x, y]: Place) -> bool {
    let [x_m, y_m] = [x, y].map(f32::from_bits);
    x_m == y_m && x_m.fract() == 0.0 && (x_m.abs() <= 1.0 || x_m.abs() >= 99.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(x_m: f32, y_m: f32) -> Place {
        [x_m.to_bits(), y_m.to_bits()]
    }

    #[test]
    fn marked_positions_are_known_at_the_first_jump_and_others_at_the_second() {
        let mut placeholders = Placeholders::default();
        assert!(!placeholders.holds(place(0.0, 0.0)));
        assert!(placeholders.add_jump(place(0.0, 0.0)) && placeholders.holds(place(0.0, 0.0)));
        assert!(placeholders.add_jump(place(-1.0, -1.0)) && placeholders.add_jump(place(-0.0, 0.0)));
        let other = place(512.0, 384.5);
        assert!(!placeholders.add_jump(other) && !placeholders.holds(other));
        assert!(placeholders.add_jump(other) && placeholders.holds(other));
    }
}
