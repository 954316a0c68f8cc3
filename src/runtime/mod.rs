//! Parts shared by the whole running program: clock, queues, metrics, faults, the daemon's health, the overview of its loops,
//! and requests to its engine.

pub mod blocks;
pub mod clock;
pub mod control;
pub mod cores;
pub mod data_health;
pub mod faults;
pub mod health;
pub mod last_values;
pub mod maintenance;
pub mod metrics;
pub mod overview;
pub mod queue;
pub mod secrets;
pub mod series;
pub mod tls;
pub mod view;
