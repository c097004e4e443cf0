//! Ablations: variants of a recipe on the same windows of the part that the recipe is evaluated on.

use std::collections::BTreeMap;

use data::OpenOptions;
use data::sets::{DataSet, Fold, Part};
use scene::{AgentType, ContextMap};

use super::interaction::{folder, short};
use super::{Footage, MapChoice, Options, Rules, SEED, map_of, no_agents};
use crate::ablation::{Ablation, AblationRow};
use crate::group::Group;
use crate::weights::Model;
use crate::{Baselines, Cut, EvaluateError, Subset};

/// A variant of a recipe.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Variant {
    /// What its row is called.
    pub name: String,
    /// Name of its weights in the folder of weights.
    pub weights: String,
    /// The richest map that it may read.
    pub map: MapChoice,
}

/// The agents that a recipe is evaluated on.
struct Windows {
    set: DataSet,
    /// The set's name for people.
    about: &'static str,
    cut: Cut,
    subset: Subset,
    of_type: Option<AgentType>,
    /// The one site whose recordings count; all where it is `None`.
    site: Option<String>,
    in_pixels: bool,
}

/// Evaluates variants of `recipe` on the same windows of the part that `options` name: those of a fold with
/// two or more pedestrians, all of Stanford Drone, or the moving vehicles of INTERACTION, at the recipe's
/// held-out site if it has one.
///
/// Every variant reads the poorer of the maps that `options` and the variant name.
///
/// # Errors
/// Where no part of a data set is the recipe's own, or weights or recordings are missing or of another kind.
pub fn ablation(
    options: &Options,
    recipe: &str,
    variants: &[Variant],
    mut progress: impl FnMut(&str),
) -> Result<Ablation, EvaluateError> {
    let windows = Windows::of(recipe).ok_or_else(|| EvaluateError::NoPart { recipe: recipe.to_owned() })?;
    let cut = windows.cut;
    let mut models = Vec::new();
    for variant in variants {
        let model = options.weights.open(&variant.weights, SEED)?;
        model.check_steps(windows.about, cut.history_len, cut.horizon_len, cut.dt_s)?;
        let reads_map = model.forecaster.config().context;
        let map = if reads_map { options.map.min(variant.map) } else { MapChoice::None };
        models.push((variant, model, map));
    }
    progress(&format!("{} part", options.part.name()));
    let footage = windows.footage(options)?;
    let sites = match models.iter().map(|(_, _, map)| map).max() {
        Some(MapChoice::Site) => windows.site_maps(options, &footage)?,
        _ => BTreeMap::new(),
    };
    let mut rows = Vec::new();
    for (variant, model, map) in models {
        progress(&variant.name);
        rows.push(AblationRow {
            name: variant.name.clone(),
            sha256: model.sha256().to_owned(),
            errors: windows.judge(options, &model, &footage, (map, &sites))?,
        });
    }
    Ok(Ablation { about: windows.description(options.part), rows })
}

impl Windows {
    fn of(recipe: &str) -> Option<Self> {
        let pedestrians = Cut { history_len: 8, horizon_len: 12, dt_s: 0.4, from_positions: false };
        let walks = |set: DataSet, about: &'static str, subset: Subset| Self {
            set,
            about,
            cut: pedestrians,
            subset,
            of_type: None,
            site: None,
            in_pixels: set == DataSet::SddTrajnet,
        };
        if recipe == "sdd" {
            return Some(walks(DataSet::SddTrajnet, "Stanford Drone, TrajNet split", Subset::All));
        }
        if let Some(fold) = Fold::ALL.into_iter().find(|fold| fold.name() == recipe) {
            return Some(walks(DataSet::EthUcyFold(fold), "ETH/UCY", Subset::Company));
        }
        let site = match recipe.strip_prefix("interaction")? {
            "" => None,
            other => Some(other.strip_prefix("-without-")?.to_owned()),
        };
        Some(Self {
            set: DataSet::Interaction,
            about: "INTERACTION",
            cut: Cut { history_len: 4, horizon_len: 10, dt_s: 0.5, from_positions: false },
            subset: Subset::Moving,
            of_type: Some(AgentType::Vehicle),
            site,
            in_pixels: false,
        })
    }

    /// The windows for people.
    fn description(&self, part: Part) -> String {
        let place = match (self.set, &self.site) {
            (DataSet::EthUcyFold(fold), _) => format!(", {}", fold.name()),
            (_, Some(site)) => format!(", held-out {site}"),
            _ => String::new(),
        };
        let agents = match self.subset {
            Subset::All => String::new(),
            Subset::Company => ", windows with 2 or more pedestrians".to_owned(),
            Subset::Moving => ", moving vehicles".to_owned(),
            Subset::Of(agent_type) => format!(", of type {}", agent_type.name()),
        };
        format!("{}{place}, {} part{agents}", self.about, part.name())
    }

    fn footage(&self, options: &Options) -> Result<Vec<Footage>, EvaluateError> {
        let mut paths = self.set.files(&options.data, options.part)?;
        if let Some(site) = &self.site {
            paths.retain(|path| short(&folder(path)) == site);
        }
        options.read(&paths, OpenOptions::of(self.set.format()), &self.cut)
    }

    /// Maps of the training recordings of the footage's sites, by site. There are none in a set without
    /// sites, or for a held-out site.
    fn site_maps(
        &self,
        options: &Options,
        footage: &[Footage],
    ) -> Result<BTreeMap<String, ContextMap>, EvaluateError> {
        if self.set != DataSet::Interaction || self.site.is_some() {
            return Ok(BTreeMap::new());
        }
        let training = options.read_part(self.set, Part::Train, &self.cut)?;
        let mut maps = BTreeMap::new();
        for site in footage.iter().map(Footage::site) {
            if !maps.contains_key(&site)
                && let Some(map) = map_of(&training, &site)
            {
                maps.insert(site, map);
            }
        }
        Ok(maps)
    }

    fn judge(
        &self,
        options: &Options,
        model: &Model,
        footage: &[Footage],
        (map, sites): (MapChoice, &BTreeMap<String, ContextMap>),
    ) -> Result<Group, EvaluateError> {
        let rules = Rules {
            horizons: &[self.cut.horizon_len],
            subsets: &[self.subset],
            of_type: self.of_type,
            threads: options.threads,
        };
        // Only the network's errors are reported.
        let baselines = Baselines::fit(std::iter::empty(), &self.cut, SEED);
        let mut groups = Vec::new();
        for footage in footage {
            let name = &footage.recording.name;
            let blocks = rules.judge(model, &baselines, footage, map.input(sites.get(&footage.site())));
            let group = Group::new(name, self.subset, 0, &blocks);
            groups.push(if self.in_pixels {
                let no_scale = || EvaluateError::NoScale { name: name.clone() };
                group.scaled("px", 1.0 / footage.recording.pixel_m.ok_or_else(no_scale)?)
            } else {
                group
            });
        }
        let about = self.description(options.part);
        let group = Group::pooled(&about, &groups.iter().collect::<Vec<_>>());
        if group.total.is_empty() { Err(no_agents(&about, &self.cut)) } else { Ok(group) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recipes_have_parts_of_their_own() {
        let description = |recipe: &str| Windows::of(recipe).map(|windows| windows.description(Part::Test));
        let expected = [
            ("hotel", Some("ETH/UCY, hotel, test part, windows with 2 or more pedestrians")),
            ("sdd", Some("Stanford Drone, TrajNet split, test part")),
            ("interaction", Some("INTERACTION, test part, moving vehicles")),
            ("interaction-without-FT", Some("INTERACTION, held-out FT, test part, moving vehicles")),
            ("interaction-FT", None),
            ("onboard", None),
        ];
        for (recipe, text) in expected {
            assert_eq!(description(recipe).as_deref(), text, "{recipe}");
        }
    }
}
