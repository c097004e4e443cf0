//! Tests of the filters: against reference runs of independent implementations, of their mathematical
//! properties, and under stress.

mod support {
    pub mod bicycle;
    pub mod state;
}

mod consistency;
mod crossing;
mod joint_update;
mod kalman;
mod mixture;
mod noise;
mod particles;
