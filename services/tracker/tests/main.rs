//! Tests of the tracker: scenes with a known result, known failures of trackers, recordings, and the stage
//! with its ports.

mod support {
    pub mod forecaster;
    pub mod harness;
}

mod audit;
mod contradicted;
mod frozen;
mod impossible;
mod jpda;
mod known_failures;
mod learned_prior;
mod noise;
mod occlusion;
mod out_of_sequence;
mod own_time;
mod predecessor;
mod recordings;
mod repeated;
mod scenes;
mod sensors;
mod stage;
mod whole;
