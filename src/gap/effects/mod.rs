//! The catalogue: one file an effect.

use super::types::{EffectId, Stage};

/// One effect that the base leaves out.
#[derive(Debug)]
pub struct Effect {
    /// Id in documents.
    pub id: EffectId,
    /// Where it acts.
    pub stage: Stage,
    /// Effects that look alike on OP and PV.
    pub confused_with: &'static [EffectId],
    /// The measurement that would tell.
    pub separated_by: &'static str,
}

/// Every effect.
pub const ALL: [&Effect; 0] = [];
