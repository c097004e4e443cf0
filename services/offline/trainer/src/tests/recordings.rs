//! Small random recordings in every file format, and variants with a different future.

use std::f64::consts::{PI, TAU};
use std::fmt::Write;
use std::path::{Path, PathBuf};

use data::Format;
use rand::{Rng, RngExt};
use wire::{AGENT_TYPES, AgentType};

/// Duration of a recording.
const DURATION_S: f64 = 8.0;
/// Number of agents in a recording; their types alternate.
const AGENTS: u64 = 7;
/// Scale of formats in pixels, m per px.
const PIXEL_M: f64 = 0.04;
/// Frames at the beginning of a recording in the project's own format that have no pose of the sensor.
const UNPLACED: usize = 20;
const CALIBRATION: &str = "R_rect 1 0 0 0 1 0 0 0 1\n\
    Tr_velo_cam 0 -1 0 0.1 0 0 -1 0.2 1 0 0 0.3\n\
    Tr_imu_velo 1 0 0 0.8 0 1 0 -0.3 0 0 1 0.8\n";

/// The observations of a moving camera.
#[derive(Clone, Debug)]
pub(crate) struct Scenery {
    rows: Vec<Row>,
    /// East (m), north (m) and heading (rad) of the sensor in every frame.
    sensor: Vec<[f64; 3]>,
}

/// One agent in one frame.
#[derive(Clone, Debug)]
struct Row {
    frame: usize,
    id: u64,
    agent_type: AgentType,
    position_m: [f64; 2],
    speed_mps: f64,
    heading_rad: f64,
    length_m: f64,
    /// Whether speed, heading and size are written in formats in which they are optional.
    is_detailed: bool,
}

/// The formats that these tests write. Tests of `data` cover the others.
pub(crate) fn written() -> impl Iterator<Item = Format> {
    let others = [Format::LevelX, Format::HighD, Format::CommonRoad, Format::Rosbag];
    Format::ALL.into_iter().filter(move |format| !others.contains(format))
}

/// Frame rate of a format, Hz.
pub(crate) fn frame_rate(format: Format) -> f64 {
    match format {
        Format::EthUcy | Format::Obsmat | Format::SddTrajnet => 2.5,
        Format::SddRaw => 30.0,
        Format::VciDut => 23.98,
        Format::Interaction | Format::KittiDetections | Format::KittiLabels | Format::Csv => 10.0,
        Format::LevelX | Format::HighD | Format::CommonRoad | Format::Rosbag => {
            unreachable!("{format} is not written")
        }
    }
}

impl Scenery {
    /// Agents that appear, wander and disappear; some stand. The first is present in every frame.
    pub(crate) fn random(frame_rate: f64, random: &mut impl Rng) -> Self {
        let frames_len = (DURATION_S * frame_rate) as usize;
        let mut rows = Vec::new();
        for id in 0..AGENTS {
            let agent_type = AGENT_TYPES[id as usize % AGENT_TYPES.len()];
            let speed_max_mps = [9.0, 5.0, 1.6][agent_type.index()];
            let mut row = Row { speed_mps: 0.0, ..Row::random(0, id, agent_type, random) };
            if random.random_bool(0.8) {
                row.speed_mps = random.random_range(0.0..speed_max_mps);
            }
            let begins = if id == 0 { 0 } else { random.random_range(0..frames_len / 2) };
            let ends = if id == 0 { frames_len } else { random.random_range(begins + 2..=frames_len) };
            for frame in begins..ends {
                row.frame = frame;
                row.is_detailed = random.random_bool(0.98);
                rows.push(row.clone());
                row.heading_rad += random.random_range(-0.5..0.5) / frame_rate;
                let [vx, vy] = row.velocity_mps();
                let mut noise_m = || random.random_range(-0.02..0.02);
                row.position_m[0] += vx / frame_rate + noise_m();
                row.position_m[1] += vy / frame_rate + noise_m();
            }
        }
        rows.sort_by_key(|row| (row.frame, row.id));
        let pose = |frame: usize| [3.0 * frame as f64 / frame_rate, 0.1 * frame as f64, 0.01 * frame as f64];
        Self { rows, sensor: (0..frames_len).map(pose).collect() }
    }

    /// The same up to frame `now`. After it, every row differs or is missing, and identities are permuted.
    pub(crate) fn with_another_future(&self, now: usize, random: &mut impl Rng) -> Self {
        let mut rows = Vec::new();
        for frame in self.rows.chunk_by(|a, b| a.frame == b.frame) {
            if frame[0].frame <= now {
                rows.extend_from_slice(frame);
                continue;
            }
            let mut ids: Vec<u64> = frame.iter().map(|row| row.id).collect();
            let swap = [0, 1].map(|_| random.random_range(0..ids.len()));
            ids.swap(swap[0], swap[1]);
            for (row, id) in frame.iter().zip(ids) {
                let any_type = AGENT_TYPES[random.random_range(0..AGENT_TYPES.len())];
                let agent_type = if random.random_bool(0.1) { any_type } else { row.agent_type };
                if random.random_bool(0.8) {
                    rows.push(Row::random(row.frame, id, agent_type, random));
                }
            }
        }
        let mut sensor = self.sensor.clone();
        for pose in &mut sensor[now + 1..] {
            *pose = pose.map(|value| value + random.random_range(-1.0..1.0));
        }
        Self { rows, sensor }
    }

    /// Writes the files of a recording. Returns the one to open.
    pub(crate) fn write(&self, format: Format, folder: &Path) -> PathBuf {
        let files = self.files(format);
        for (name, content) in &files {
            let path = folder.join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, content).unwrap();
        }
        folder.join(files[0].0)
    }

    /// Names and contents of a recording's files, the one to open first.
    fn files(&self, format: Format) -> Vec<(&'static str, String)> {
        match format {
            Format::EthUcy => vec![("rows.txt", self.table("", |row| Some(row.positions(10))))],
            Format::SddTrajnet => vec![("rows.txt", self.table("", |row| Some(row.positions(12))))],
            Format::Obsmat => vec![("rows.txt", self.table("", |row| Some(row.obsmat())))],
            Format::SddRaw => vec![
                ("scene/video/annotations.txt", self.table("", |row| Some(row.sdd_raw()))),
                (
                    "estimated_scales.yaml",
                    format!("scene:\n  video:\n    scale: {PIXEL_M}\n    certainty: 1\n"),
                ),
            ],
            Format::Interaction => {
                let walkers =
                    |row: &Row| (!row.drives() && row.frame.is_multiple_of(4)).then(|| row.interaction());
                let header = "track_id,frame_id,timestamp_ms,agent_type,x,y";
                let drivers = |row: &Row| row.drives().then(|| row.interaction());
                let more = format!("{header},vx,vy,psi_rad,length,width\n");
                vec![
                    ("vehicle_tracks_000.csv", self.table(&more, drivers)),
                    ("pedestrian_tracks_000.csv", self.table(&format!("{header}\n"), walkers)),
                ]
            }
            Format::VciDut => {
                let header = "id,frame,label,x_est,y_est";
                let of = |drives: bool| move |row: &Row| (row.drives() == drives).then(|| row.vci_dut());
                vec![
                    ("a_veh_b.csv", self.table(&format!("{header},psi_est,vel_est\n"), of(true))),
                    ("a_ped_b.csv", self.table(&format!("{header},vx_est,vy_est\n"), of(false))),
                ]
            }
            Format::KittiLabels => {
                [vec![("label/0.txt", self.table("", |row| Some(row.kitti_label())))], self.kitti()].concat()
            }
            Format::KittiDetections => {
                let of = |agent_type| {
                    move |row: &Row| (row.agent_type == agent_type).then(|| row.kitti_detection())
                };
                let files = vec![
                    ("detection/Car/0.txt", self.table("", of(AgentType::Vehicle))),
                    ("detection/Pedestrian/0.txt", self.table("", of(AgentType::Pedestrian))),
                    ("detection/Cyclist/0.txt", self.table("", of(AgentType::Cyclist))),
                    ("label/0.txt", self.table("", |row| Some(row.kitti_label()))),
                ];
                [files, self.kitti()].concat()
            }
            Format::Csv => vec![("rows.csv", self.csv())],
            Format::LevelX | Format::HighD | Format::CommonRoad | Format::Rosbag => {
                unreachable!("{format} is not written")
            }
        }
    }

    fn table(&self, header: &str, line: impl Fn(&Row) -> Option<String>) -> String {
        let lines = self.rows.iter().filter_map(line).map(|line| line + "\n");
        std::iter::once(header.to_owned()).chain(lines).collect()
    }

    /// The calibration and ego motion of a sequence.
    fn kitti(&self) -> Vec<(&'static str, String)> {
        let unused = " 0".repeat(24);
        let pose = |[east_m, north_m, heading_rad]: &[f64; 3]| {
            let [latitude, longitude] = [49.0 + north_m * 9e-6, 8.4 + east_m * 1.4e-5];
            format!("{latitude} {longitude} 112 0.01 -0.01 {heading_rad}{unused}\n")
        };
        vec![("calib/0.txt", CALIBRATION.to_owned()), ("oxts/0.txt", self.sensor.iter().map(pose).collect())]
    }

    fn csv(&self) -> String {
        let header = "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps,length_m,width_m\n";
        let mut text = self.table(header, |row| Some(row.csv()));
        for (frame, [x, y, heading]) in self.sensor.iter().enumerate().skip(UNPLACED).step_by(3) {
            writeln!(text, "{},,ego,{x},{y},{heading},,,", stamp_s(frame)).unwrap();
        }
        text
    }
}

/// A stamp at ten frames a second.
fn stamp_s(frame: usize) -> String {
    format!("{}.{}", frame / 10, frame % 10)
}

impl Row {
    /// An agent with random state.
    fn random(frame: usize, id: u64, agent_type: AgentType, random: &mut impl Rng) -> Self {
        Self {
            frame,
            id,
            agent_type,
            position_m: [0, 1].map(|_| random.random_range(-25.0..25.0)),
            speed_mps: random.random_range(0.0..12.0),
            heading_rad: random.random_range(-PI..PI),
            length_m: random.random_range(1.0..12.0),
            is_detailed: random.random_bool(0.5),
        }
    }

    fn drives(&self) -> bool {
        self.agent_type == AgentType::Vehicle
    }

    fn velocity_mps(&self) -> [f64; 2] {
        [self.heading_rad.cos() * self.speed_mps, self.heading_rad.sin() * self.speed_mps]
    }

    fn positions(&self, frames_per_step: usize) -> String {
        let ([x, y], separator) = (self.position_m, if frames_per_step == 10 { '\t' } else { ' ' });
        [(self.frame * frames_per_step).to_string(), self.id.to_string(), x.to_string(), y.to_string()]
            .join(&separator.to_string())
    }

    fn obsmat(&self) -> String {
        let ([x, y], [vx, vy]) = (self.position_m, self.velocity_mps());
        format!("{} {} {x} 0 {y} {vx} 0 {vy}", self.frame * 6, self.id)
    }

    fn sdd_raw(&self) -> String {
        let [x, y] = self.position_m.map(|x_m| x_m / PIXEL_M);
        let half = self.length_m / PIXEL_M / 2.0;
        let corners = format!("{} {} {} {}", x - half, y - half, x + half, y + half);
        let label = ["Car", "Biker", "Pedestrian"][self.agent_type.index()];
        format!("{} {corners} {} 0 0 0 \"{label}\"", self.id, self.frame)
    }

    fn interaction(&self) -> String {
        let Self { frame, id, position_m: [x, y], heading_rad, length_m, .. } = self;
        let stamp_ms = frame * 100;
        if !self.drives() {
            return format!("P{id},{frame},{stamp_ms},pedestrian/bicycle,{x},{y}");
        }
        let [vx, vy] = self.velocity_mps();
        format!("{id},{frame},{stamp_ms},car,{x},{y},{vx},{vy},{heading_rad},{length_m},2")
    }

    fn vci_dut(&self) -> String {
        let Self { frame, id, position_m: [x, y], heading_rad, speed_mps, .. } = self;
        if self.drives() {
            return format!("{id},{frame},veh,{x},{y},{heading_rad},{speed_mps}");
        }
        let [vx, vy] = self.velocity_mps();
        format!("{id},{frame},ped,{x},{y},{vx},{vy}")
    }

    fn kitti_label(&self) -> String {
        let label = ["Car", "Cyclist", "Pedestrian"][self.agent_type.index()];
        let Self { frame, id, position_m: [x, z], heading_rad, length_m, .. } = self;
        format!("{frame} {id} {label} 0 0 0 0 0 0 0 1.5 1.8 {length_m} {x} 1.7 {z} {heading_rad}")
    }

    fn kitti_detection(&self) -> String {
        let number = [2, 3, 1][self.agent_type.index()];
        let Self { frame, position_m: [x, z], speed_mps: score, length_m, .. } = self;
        let turned_rad = self.heading_rad.rem_euclid(TAU);
        format!("{frame},{number},0,0,0,0,{score},1.5,1.8,{length_m},{x},1.7,{z},{turned_rad},0")
    }

    fn csv(&self) -> String {
        let Self { id, position_m: [x, y], heading_rad, speed_mps, length_m, .. } = self;
        let more = match self.is_detailed {
            true => format!("{heading_rad},{speed_mps},{length_m},1.8"),
            false => ",,,".to_owned(),
        };
        format!("{},{id},{},{x},{y},{more}", stamp_s(self.frame), self.agent_type.name())
    }
}
