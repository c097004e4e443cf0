use wire::{AgentType, Forecast, HORIZON_MAX, MODES_MAX};

/// Circles of an outline.
const CIRCLES: usize = 3;
/// Radius of a pedestrian.
const PEDESTRIAN_M: f32 = 0.3;
/// Least width of any other agent.
const WIDTH_MIN_M: f32 = 0.5;
/// Below this distance of a step, an agent keeps its direction.
const STEP_MIN_M: f32 = 0.1;

/// What the outline of an agent depends on, besides its path.
#[derive(Clone, Copy, Debug)]
pub struct Body {
    /// The type.
    pub agent_type: AgentType,
    /// Length and width, m; 0 if unknown.
    pub size_m: [f32; 2],
    /// Position before the first step.
    pub position_m: [f32; 2],
    /// Heading before the first step.
    pub heading_rad: f32,
}

/// The circles of an agent along one path, or along several that it may take.
#[derive(Clone, Debug)]
pub struct Outline {
    /// Steps.
    pub(crate) len: usize,
    circle_count: usize,
    pub(crate) radius_m: f32,
    paths_len: usize,
    /// Middles of the circles, \[step, circle, path\]: a loop over paths reads successive numbers.
    x_m: [[[f32; MODES_MAX]; CIRCLES]; HORIZON_MAX],
    y_m: [[[f32; MODES_MAX]; CIRCLES]; HORIZON_MAX],
    /// Least and greatest x and y of these middles at each step.
    boxes: [Extent; HORIZON_MAX],
}

/// Least and greatest x and y, m.
#[derive(Clone, Copy, Debug)]
struct Extent {
    from_m: [f32; 2],
    to_m: [f32; 2],
}

impl Body {
    /// The agent of a forecast; `None` for an unknown type.
    #[must_use]
    pub fn of(forecast: &Forecast) -> Option<Self> {
        Some(Self {
            agent_type: AgentType::try_from(forecast.agent_type).ok()?,
            size_m: [forecast.length_m, forecast.width_m],
            position_m: [forecast.x_m, forecast.y_m],
            heading_rad: forecast.heading_rad,
        })
    }

    /// The outline along paths of equal length. Paths beyond [`MODES_MAX`] and steps beyond [`HORIZON_MAX`] are
    /// left out.
    #[must_use]
    pub fn along<'a>(&self, paths_m: impl IntoIterator<Item = &'a [[f32; 2]]>) -> Outline {
        let mut outline = Outline::default();
        outline.draw(self, paths_m);
        outline
    }
}

impl Default for Outline {
    /// No path.
    fn default() -> Self {
        let (x_m, y_m) =
            ([[[0.0; MODES_MAX]; CIRCLES]; HORIZON_MAX], [[[0.0; MODES_MAX]; CIRCLES]; HORIZON_MAX]);
        let boxes = [Extent::NOTHING; HORIZON_MAX];
        Self { len: 0, circle_count: 1, radius_m: 0.0, paths_len: 0, x_m, y_m, boxes }
    }
}

impl Outline {
    /// Draws the outline of an agent along paths, in place of the present one.
    pub(crate) fn draw<'a>(&mut self, body: &Body, paths_m: impl IntoIterator<Item = &'a [[f32; 2]]>) {
        let is_pedestrian = body.agent_type == AgentType::Pedestrian;
        let [length_m, width_m] = body.size_m;
        (self.circle_count, self.radius_m) =
            if is_pedestrian { (1, PEDESTRIAN_M) } else { (CIRCLES, 0.5 * width_m.max(WIDTH_MIN_M)) };
        let reach_m = if is_pedestrian { 0.0 } else { (0.5 * length_m - self.radius_m).max(0.0) };
        let ahead = [body.heading_rad.cos(), body.heading_rad.sin()];
        (self.len, self.paths_len) = (0, 0);
        self.boxes.fill(Extent::NOTHING);
        for (path, path_m) in paths_m.into_iter().take(MODES_MAX).enumerate() {
            let (mut from_m, mut direction) = (body.position_m, ahead);
            for (step, at_m) in path_m.iter().take(HORIZON_MAX).enumerate() {
                let [x, y] = [at_m[0] - from_m[0], at_m[1] - from_m[1]];
                let step_m = (x * x + y * y).sqrt();
                if step_m > STEP_MIN_M {
                    direction = [x / step_m, y / step_m];
                }
                for (circle, along_m) in
                    [0.0, reach_m, -reach_m].into_iter().take(self.circle_count).enumerate()
                {
                    let middle_m = [0, 1].map(|axis| at_m[axis] + along_m * direction[axis]);
                    [self.x_m[step][circle][path], self.y_m[step][circle][path]] = middle_m;
                    self.boxes[step].add(middle_m);
                }
                from_m = *at_m;
            }
            (self.len, self.paths_len) = (path_m.len().min(HORIZON_MAX), path + 1);
        }
    }

    /// The smallest distance between the first paths of two outlines at a common step, and that step. It is
    /// negative if the outlines overlap, and infinite without a common step.
    #[must_use]
    pub fn gap(&self, other: &Self) -> (f32, usize) {
        let mut least = (f32::INFINITY, 0);
        for step in 0..self.len.min(other.len) {
            for a in 0..self.circle_count {
                for b in 0..other.circle_count {
                    let x = self.x_m[step][a][0] - other.x_m[step][b][0];
                    let y = self.y_m[step][a][0] - other.y_m[step][b][0];
                    if x * x + y * y < least.0 {
                        least = (x * x + y * y, step);
                    }
                }
            }
        }
        (least.0.sqrt() - self.radius_m - other.radius_m, least.1)
    }

    /// The agent's position at a step of a path.
    pub(crate) const fn middle_m(&self, step: usize, path: usize) -> [f32; 2] {
        [self.x_m[step][0][path], self.y_m[step][0][path]]
    }

    /// Whether some paths may come nearer than a gap at a step: false if their boxes are farther apart.
    pub(crate) fn may_be_within(&self, other: &Self, step: usize, gap_m: f32) -> bool {
        let (a, b) = (&self.boxes[step], &other.boxes[step]);
        let apart_m =
            [0, 1].map(|axis| (a.from_m[axis] - b.to_m[axis]).max(b.from_m[axis] - a.to_m[axis]).max(0.0));
        let reach_m = gap_m + self.radius_m + other.radius_m;
        apart_m[0] * apart_m[0] + apart_m[1] * apart_m[1] <= reach_m * reach_m
    }

    /// Lowers squares of distances, \[own path, other's path\], to the ones of a step's circles.
    pub(crate) fn lower(&self, other: &Self, step: usize, least_m2: &mut [[f32; MODES_MAX]; MODES_MAX]) {
        for a in 0..self.circle_count {
            for b in 0..other.circle_count {
                let (x_m, y_m) = (&other.x_m[step][b], &other.y_m[step][b]);
                for (path, least_m2) in least_m2[..self.paths_len].iter_mut().enumerate() {
                    let (own_x_m, own_y_m) = (self.x_m[step][a][path], self.y_m[step][a][path]);
                    for ((least_m2, x_m), y_m) in least_m2.iter_mut().zip(x_m).zip(y_m) {
                        let [x, y] = [own_x_m - x_m, own_y_m - y_m];
                        *least_m2 = least_m2.min(x * x + y * y);
                    }
                }
            }
        }
    }
}

impl Extent {
    const NOTHING: Self = Self { from_m: [f32::INFINITY; 2], to_m: [f32::NEG_INFINITY; 2] };

    fn add(&mut self, at_m: [f32; 2]) {
        for (axis, at_m) in at_m.into_iter().enumerate() {
            self.from_m[axis] = self.from_m[axis].min(at_m);
            self.to_m[axis] = self.to_m[axis].max(at_m);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn body(agent_type: AgentType, size_m: [f32; 2]) -> Body {
        Body { agent_type, size_m, position_m: [0.0; 2], heading_rad: 0.0 }
    }

    fn car(path_m: &[[f32; 2]]) -> Outline {
        body(AgentType::Vehicle, [4.0, 2.0]).along([path_m])
    }

    #[test]
    fn gaps_are_between_outlines_and_not_between_centres() {
        let ahead = car(&[[10.0, 0.0]]);
        let (gap_m, _) = car(&[[0.1, 0.0]]).gap(&ahead);
        assert!((gap_m - 5.9).abs() < 1e-4, "{gap_m}");
        let beside = body(AgentType::Pedestrian, [0.5; 2]).along([&[[0.1, 3.0]][..]]);
        let (gap_m, _) = car(&[[0.1, 0.0]]).gap(&beside);
        assert!((gap_m - 1.7).abs() < 1e-4, "{gap_m}");
    }

    #[test]
    fn the_gap_is_at_a_common_step() {
        let first = car(&[[10.0, 0.0], [20.0, 0.0]]);
        let later = car(&[[30.0, 0.0], [10.0, 0.0]]);
        assert_eq!(first.gap(&later).1, 1);
        assert!((first.gap(&later).0 - 6.0).abs() < 1e-4, "{:?}", first.gap(&later));
        assert_eq!(first.gap(&Outline::default()).0, f32::INFINITY);
    }

    #[test]
    fn the_least_of_many_paths_is_the_gap_of_single_paths() {
        let paths_m: [[[f32; 2]; 2]; 3] =
            [[[1.0, 0.0], [3.0, 1.0]], [[2.0, 1.0], [5.0, 3.0]], [[0.0, 0.0], [0.02, 0.0]]];
        let others_m: [[[f32; 2]; 2]; 2] = [[[9.0, 2.0], [7.0, 1.0]], [[4.0, 8.0], [4.0, 5.0]]];
        let vehicle = body(AgentType::Vehicle, [4.5, 1.8]);
        let person = body(AgentType::Pedestrian, [0.6; 2]);
        for other in [vehicle, person] {
            let (all, others) = (
                vehicle.along(paths_m.iter().map(|path| &path[..])),
                other.along(others_m.iter().map(|path| &path[..])),
            );
            let mut least_m2 = [[f32::INFINITY; MODES_MAX]; MODES_MAX];
            (0..2).for_each(|step| all.lower(&others, step, &mut least_m2));
            for (path_m, of_path_m2) in paths_m.iter().zip(&least_m2) {
                for (other_m, m2) in others_m.iter().zip(of_path_m2) {
                    let (gap_m, _) = vehicle.along([&path_m[..]]).gap(&other.along([&other_m[..]]));
                    assert_eq!(gap_m, m2.sqrt() - all.radius_m - others.radius_m);
                }
            }
        }
    }

    #[test]
    fn boxes_exclude_only_paths_that_are_farther_apart() {
        let (here, there) = (car(&[[1.0, 0.0]]), car(&[[9.0, 3.0]]));
        let (gap_m, _) = here.gap(&there);
        assert!(here.may_be_within(&there, 0, gap_m));
        assert!(!here.may_be_within(&there, 0, 0.5));
    }
}
