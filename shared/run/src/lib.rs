//! The definition of a run: the record with which every stage is started, the declaration of a stage, and the
//! exit codes.
//!
//! [`Run`] contains everything on which all stages of one run must agree, such as the location of its shared
//! memory and the weights. The launcher writes it once, and every stage reads it. Settings that concern only
//! one stage are its *options*. They are a TOML table in the run's record, which the stage reads as its own
//! struct.
//!
//! Each stage has one constant, its [`Declaration`]. It names the stage, the topics that the stage reads and
//! writes, and the struct of its options. The fields of this struct, with their documentation, defaults and
//! ranges, are the only definition of an option. pipeline.toml and the command line are checked against it,
//! and `stgdat stage --help` is generated from it.
//!
//! ```
//! use run::{Declaration, Declared, Run, StageRun};
//! use schemars::JsonSchema;
//! use serde::{Deserialize, Serialize};
//! use wire::StageId;
//!
//! /// What may be set of the stage.
//! #[derive(Default, Serialize, Deserialize, JsonSchema)]
//! #[serde(deny_unknown_fields, default)]
//! struct Options {
//!     /// Maximum number of threads; one for each core if not given.
//!     #[schemars(range(min = 1, max = 64))]
//!     workers: Option<usize>,
//! }
//!
//! const STAGE: Declaration<Options> = Declaration::new(StageId::Encoder, &["features"], &["encodings"]);
//!
//! // The launcher checks what pipeline.toml and the command line set …
//! let refused = STAGE.check(&"workers = 65".parse()?).unwrap_err();
//! assert_eq!(format!("{refused}: {}", refused.advice()), "`workers` is out of range: expected 1 to 64");
//!
//! // … and writes it to the run's record, from which the stage reads it.
//! let stages = vec![StageRun::with_options(&STAGE, &Options { workers: Some(4) })?];
//! let run = Run { stages, ..Run::default() };
//! assert_eq!(STAGE.options(&run)?.workers, Some(4));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod declaration;
mod exit;
pub mod options;
mod record;
mod speed_limits;

pub use declaration::{
    Conflict, Declaration, Declared, NoOptions, OptionError, STAGE_VARIABLE, is_feedback, own_stage,
};
pub use exit::Exit;
pub use record::{PROTECTED, RecordError, Run, SpareRun, StageRun, TopicRun, injected_name, injected_topic};
pub use speed_limits::SpeedLimits;
