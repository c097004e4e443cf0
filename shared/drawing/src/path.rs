//! Outlines and lines, as the path data of SVG.

/// A position on the sheet in pt, from its upper left corner; y points down.
pub type Spot = [f64; 2];

/// The outline of an area, or a line.
#[derive(Clone, Debug, Default)]
pub struct Path(pub(crate) String);

impl Path {
    /// Whether nothing was added.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Starts a new part.
    pub fn move_to(&mut self, spot: Spot) {
        self.command('M', &[spot]);
    }

    /// Adds a straight line to the spot.
    pub fn line_to(&mut self, spot: Spot) {
        self.command('L', &[spot]);
    }

    /// Adds a parabola to the spot.
    pub fn quad_to(&mut self, control: Spot, spot: Spot) {
        self.command('Q', &[control, spot]);
    }

    /// Adds a cubic curve to the spot.
    pub fn cubic_to(&mut self, controls: [Spot; 2], spot: Spot) {
        self.command('C', &[controls[0], controls[1], spot]);
    }

    /// Returns to the start of the part.
    pub fn close(&mut self) {
        self.0.push('Z');
    }

    /// Adds a part through all spots.
    pub fn add_line(&mut self, spots: impl IntoIterator<Item = Spot>) {
        for (index, spot) in spots.into_iter().enumerate() {
            if index == 0 { self.move_to(spot) } else { self.line_to(spot) }
        }
    }

    /// The line through all spots.
    pub fn line(spots: impl IntoIterator<Item = Spot>) -> Self {
        let mut path = Self::default();
        path.add_line(spots);
        path
    }

    /// The area within all spots.
    pub fn polygon(spots: impl IntoIterator<Item = Spot>) -> Self {
        let mut path = Self::line(spots);
        path.close();
        path
    }

    /// A disc.
    pub fn disc([x, y]: Spot, radius: f64) -> Self {
        // Four cubic curves with this handle deviate from a circle by 0.03 % of its radius.
        let handle = 0.552_284_75 * radius;
        let mut path = Self::default();
        path.move_to([x + radius, y]);
        for [cos, sin] in [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]] {
            let at =
                |along: f64, across: f64| [x + along * cos - across * sin, y + along * sin + across * cos];
            path.cubic_to([at(radius, handle), at(handle, radius)], at(0.0, radius));
        }
        path.close();
        path
    }

    fn command(&mut self, letter: char, spots: &[Spot]) {
        self.0.push(letter);
        for (index, [x, y]) in spots.iter().enumerate() {
            if index > 0 {
                self.0.push(' ');
            }
            append_number(&mut self.0, *x);
            self.0.push(' ');
            append_number(&mut self.0, *y);
        }
    }
}

/// Appends a number with at most two decimals. A hundredth of a point is finer than any printer.
pub(crate) fn append_number(text: &mut String, value: f64) {
    let hundredths = (value * 100.0).round();
    let value = if hundredths == 0.0 { 0.0 } else { hundredths / 100.0 };
    text.push_str(&value.to_string());
}
