use std::collections::BTreeMap;
use std::path::PathBuf;

use data::sets::DataSet;
use nn::{
    Attention, Displacement, Feedback, Integrator, Latents, ModelConfig, NodeTypes, Stem, Temporal,
    VehicleMotion,
};

use serde::de::IgnoredAny;

use crate::TrainError;
use crate::objective::Objective;
use crate::optimiser::OptimiserOptions;

/// Most threads that a batch is split over.
const WORKERS_MAX: usize = 64;

/// Data, model and duration of a training.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainOptions {
    /// Name of the recipe of these options, see [`recipe`](crate::recipe).
    pub recipe: Option<String>,
    /// Folder that holds the data sets.
    pub data: PathBuf,
    /// A user's own recordings, the data set `own`.
    pub files: Vec<PathBuf>,
    /// Names of the data sets for training, see [`DataSet::name`].
    pub sets: Vec<String>,
    /// Names of the data sets for validation.
    pub validation_sets: Vec<String>,
    /// Held-out sites or scenes: recordings whose path contains one of these are left out.
    pub leave_out: Vec<String>,
    /// Whether velocities and headings are differences of positions even where the recordings have their own.
    pub from_positions: bool,
    /// Training windows of each data set at most; spread evenly over the set.
    pub windows: usize,
    /// Safetensors file to write.
    pub out: PathBuf,
    /// Folder for checkpoints, and for the unnamed scratch file of scenes during a training.
    pub checkpoints: PathBuf,
    /// Whether to resume from the newest checkpoint.
    pub resume: bool,
    /// Weights files of the same model to begin with, their base control included; of several their mean, in which
    /// a file counts as often as it is named. If there are none, training begins with random weights and fits the
    /// base control.
    #[serde(deserialize_with = "one_or_many")]
    pub begin_with: Vec<PathBuf>,
    /// Whether to fit the base control to the training data even with `begin_with`. The network then learns what the
    /// new base lacks. Agent types with fewer than 100 windows keep their base.
    pub refit_base: bool,
    /// Seed of everything random.
    pub seed: u64,
    /// Updates to make. With `begin_with` there may be none: its weights, or their mean, are validated and written
    /// with what they lack, the support of their base control, fitted to the training data, and what a card of this
    /// version tells.
    pub steps: u64,
    /// Agents in a batch, at least; a batch is filled with whole scenes.
    pub batch_agents: usize,
    /// Agents of a scene that are shown at most.
    pub scene_agents: usize,
    /// Neighbours of an agent at most, itself included.
    pub neighbours: usize,
    /// Neighbouring windows that are shown together: they share most of their patches and relations.
    pub clip_windows: usize,
    /// Parts of a batch that are differentiated in parallel, one thread each.
    pub workers: usize,
    /// Without effect: the cards of the shipped weights contain it.
    #[serde(skip_serializing)]
    pub gpu: IgnoredAny,
    /// Share of the clips that are shown without a map.
    pub without_map: f64,
    /// Share of the clips that are shown with the map of the site's other recordings; the rest have the
    /// online map.
    pub site_map: f64,
    /// Deviation of the logarithm of the scale at which scenes without vehicles are shown.
    pub scale_deviation: f64,
    /// The same for the pedestrians of the base control's fit; 0 fits recorded scales alone.
    pub base_scale_deviation: f64,
    /// Share of the standing agents that the loss counts.
    pub standing: f64,
    /// Whether only agents with a whole history count, as in the protocols of pedestrian data sets.
    pub whole_history: bool,
    /// Share of the agents whose history is cut to a random length of two steps or more.
    pub short_history: f64,
    /// Share of the agents whose history is made noisy.
    pub noisy_history: f64,
    /// Share of the clips whose velocities and headings are differences of positions even where the recording
    /// has its own. The base control is then fitted to such histories too.
    pub differenced_history: f64,
    /// Evenness of the draw of sites in a data set: by size where 0, by its square root where 0.5, uniform
    /// where 1.
    pub even_sites: f64,
    /// Share of the clips of fast roads that are shown at a larger scale, so that their vehicles are faster.
    pub faster: f64,
    /// Factors of the weights by which data sets are drawn, by name; 1 for all others.
    pub set_weights: BTreeMap<String, f64>,
    /// Bounds of the base control's speed bins of vehicles; if none, those of streets.
    pub vehicle_speed_cuts_mps: Option<[f32; nn::base::SPEED_BINS - 1]>,
    /// Updates between two validations.
    pub validate_every: u64,
    /// Agents of each set in a validation during training at most.
    pub validation_agents: usize,
    /// Validations without improvement after which training stops.
    pub patience: u32,
    /// The loss.
    pub objective: Objective,
    /// The optimiser.
    pub optimiser: OptimiserOptions,
    /// The model.
    pub model: ModelConfig,
}

impl Default for TrainOptions {
    fn default() -> Self {
        let names = |sets: &[DataSet]| sets.iter().map(|set| set.name().to_owned()).collect();
        let validated = [
            DataSet::EthUcy,
            DataSet::SddTrajnet,
            DataSet::Interaction,
            DataSet::VciDut,
            DataSet::KittiLabels,
        ];
        let learned = [&validated[..], &[DataSet::SddRaw]].concat();
        Self {
            recipe: None,
            data: PathBuf::from("data"),
            files: Vec::new(),
            sets: names(&learned),
            validation_sets: names(&validated),
            leave_out: Vec::new(),
            from_positions: false,
            windows: 20_000,
            out: PathBuf::from("weights.safetensors"),
            checkpoints: PathBuf::from("checkpoints"),
            resume: false,
            begin_with: Vec::new(),
            refit_base: false,
            seed: 1,
            steps: 8_000,
            batch_agents: 96,
            scene_agents: 12,
            neighbours: 8,
            clip_windows: 4,
            workers: 1,
            gpu: IgnoredAny,
            without_map: 0.3,
            site_map: 0.1,
            scale_deviation: 0.0,
            base_scale_deviation: 0.0,
            standing: 1.0,
            whole_history: false,
            short_history: 0.3,
            noisy_history: 0.5,
            differenced_history: 0.15,
            even_sites: 1.0,
            faster: 0.0,
            set_weights: BTreeMap::new(),
            vehicle_speed_cuts_mps: None,
            validate_every: 1_000,
            validation_agents: 400,
            patience: 12,
            objective: Objective::plus(),
            optimiser: OptimiserOptions::default(),
            model: onboard_config(),
        }
    }
}

impl TrainOptions {
    /// Refuses options that cannot be trained.
    ///
    /// # Errors
    /// [`TrainError::Model`] or [`TrainError::Options`] with the options at fault.
    pub fn check(&self) -> Result<(), TrainError> {
        self.model.check().map_err(TrainError::Model)?;
        let refuse = |reason: &str| Err(TrainError::Options(reason.to_owned()));
        let points = self.model.latents == Latents::Points;
        match self.objective {
            Objective::Plus { .. } if !(points && self.model.best_latent && self.model.mode_head) => refuse(
                "the plus objective needs model.latents = \"points\", model.best_latent and model.mode_head",
            ),
            Objective::Paper { .. } if points || self.model.base => {
                refuse("the paper objective needs model.latents = \"normal\" and no model.base")
            }
            _ if self.model.history_len < 2 => refuse("model.history_len must be 2 or more"),
            _ if self.batch_agents == 0
                || self.scene_agents == 0
                || self.neighbours == 0
                || self.windows == 0
                || self.clip_windows == 0
                || !(1..=WORKERS_MAX).contains(&self.workers) =>
            {
                refuse(
                    "windows, batch_agents, scene_agents, neighbours and clip_windows must be 1 or more, \
                     workers 1 to 64",
                )
            }
            _ if !self.shares().iter().all(|share| (0.0..=1.0).contains(share)) => refuse(
                "without_map, site_map and their sum, short_history, noisy_history, differenced_history, standing \
                 and faster must be 0 to 1",
            ),
            _ if ![self.scale_deviation, self.base_scale_deviation]
                .iter()
                .all(|deviation| (0.0..1.0).contains(deviation)) =>
            {
                refuse("scale_deviation and base_scale_deviation must be 0 or more and less than 1")
            }
            _ if !(0.0..=1.0).contains(&self.even_sites) => refuse("even_sites must be 0 to 1"),
            _ if self.set_weights.values().any(|weight| !(0.0..=1000.0).contains(weight)) => {
                refuse("set_weights must be 0 to 1000")
            }
            _ if self.validate_every == 0 || (self.steps == 0 && self.begin_with.is_empty()) => {
                refuse("steps and validate_every must be 1 or more; steps may be 0 with begin_with")
            }
            _ => Ok(()),
        }
    }
}

impl TrainOptions {
    /// The same options with default paths and `resume`, which have no effect on the model.
    pub fn without_places(&self) -> Self {
        let Self { data, out, checkpoints, resume, .. } = Self::default();
        let names = self.begin_with.iter().filter_map(|path| path.file_name());
        let begin_with = names.map(PathBuf::from).collect();
        Self { data, out, checkpoints, resume, begin_with, ..self.clone() }
    }

    fn shares(&self) -> [f64; 8] {
        [
            self.without_map,
            self.site_map,
            self.without_map + self.site_map,
            self.short_history,
            self.noisy_history,
            self.differenced_history,
            self.standing,
            self.faster,
        ]
    }
}

/// A list of paths, or one or none, as cards of the first versions have it and a command line gives it.
fn one_or_many<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Vec<PathBuf>, D::Error> {
    #[derive(serde::Deserialize)]
    #[serde(untagged, expecting = "a path or a list of paths")]
    enum Paths {
        AtMostOne(Option<PathBuf>),
        Many(Vec<PathBuf>),
    }
    match serde::Deserialize::deserialize(deserializer)? {
        Paths::AtMostOne(path) => Ok(path.into_iter().collect()),
        Paths::Many(paths) => Ok(paths),
    }
}

/// The model that the pipeline runs: all agent types in one, at 0.4 s.
#[must_use]
pub(crate) fn onboard_config() -> ModelConfig {
    ModelConfig {
        width: 16,
        stem: Stem::Compact,
        patch_size: 16,
        patch_cell_m: 2.0,
        patch_ahead_m: 0.0,
        edge_radius_m: 30.0,
        pedestrian_edge_radius_m: Some(10.0),
        history_len: 8,
        horizon_len: 12,
        dt_s: 0.4,
        rounds: 2,
        topological_heads: 4,
        temporal_heads: 4,
        temporal: Temporal::ValueMatrix,
        attention: Attention::Dual,
        node_types: NodeTypes::Own,
        edge_in_message: true,
        distance_scale: true,
        position_scale: 0.1,
        velocity_scale: 0.2,
        leaky_slope: 0.01,
        vehicle_motion: VehicleMotion::Bicycle,
        integrator: Integrator::Midpoint,
        accel_limit_mps2: 6.0,
        slip_rate_limit_radps: 1.0,
        slip_limit_rad: Some(0.5),
        initial_slip: true,
        rear_axle_ratio: 0.26,
        default_length_m: 4.5,
        displacement: Displacement::Residual,
        latents: Latents::Points,
        modes: 20,
        mode_head: true,
        best_latent: true,
        base: true,
        base_latent: true,
        base_support: false,
        context: true,
        feedback: Feedback::Zeros,
    }
}

pub(crate) fn set_named(name: &str) -> Result<DataSet, TrainError> {
    let sets = [
        DataSet::EthUcy,
        DataSet::SddTrajnet,
        DataSet::SddRaw,
        DataSet::Interaction,
        DataSet::VciDut,
        DataSet::KittiLabels,
        DataSet::KittiDetections,
        DataSet::Driving,
        DataSet::Ngsim,
        DataSet::Generated,
        DataSet::Womd,
        DataSet::Own,
    ];
    let folds = data::sets::Fold::ALL.map(DataSet::EthUcyFold);
    let known = || sets.into_iter().chain(folds);
    known().find(|set| set.name() == name).ok_or_else(|| {
        let names: Vec<&str> = known().map(DataSet::name).collect();
        TrainError::Options(format!("unknown data set \"{name}\": expected one of {}", names.join(", ")))
    })
}
