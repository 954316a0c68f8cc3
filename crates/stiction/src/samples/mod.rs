//! From raw samples to the record of one estimate: samples joined by source time, and a loop's history in bounded memory.

pub mod align;
#[cfg(test)]
mod align_check;
pub mod history;
mod op_trail;
