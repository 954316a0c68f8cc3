//! The loops of one plant judged together, after each was judged separately.

use std::collections::HashSet;

use super::{AnalysisError, Answer};
use crate::alarm::LoopContext;
use stiction::core::record::Record;
use stiction::plantwide::{GroupDocument, PlantLoop, assess_plant};

/// One loop of a plant.
#[derive(Debug)]
pub struct OfPlant<'a> {
    /// Its separate answer.
    pub answer: &'a mut Answer,
    /// The record behind the answer.
    pub record: &'a Record,
    /// Its configured context.
    pub place: &'a LoopContext,
}

/// Finds the groups of loops that share an oscillation, and puts each group's judgement into its members' answers.
///
/// # Errors
/// Two loops have the same name.
pub fn judge_together(plant: &mut [OfPlant]) -> Result<Vec<GroupDocument>, AnalysisError> {
    let mut names = HashSet::new();
    if let Some(twice) = plant.iter().map(|one| &one.answer.document.loop_name).find(|name| !names.insert(*name)) {
        return Err(AnalysisError::Twice { name: twice.clone() });
    }
    let loops: Vec<PlantLoop> = plant
        .iter()
        .map(|OfPlant { answer, record, place }| {
            let document = &answer.document;
            PlantLoop {
                name: &document.loop_name,
                record,
                assessment: &document.assessment,
                area: place.area.as_deref(),
                upstream: &place.upstream,
            }
        })
        .collect();
    let groups = assess_plant(&loops);
    for one in plant {
        let name = &one.answer.document.loop_name;
        let found = groups.iter().flat_map(|group| &group.judgements).find(|judged| judged.loop_name == *name);
        if let Some(judged) = found {
            judged.apply(&mut one.answer.document.assessment);
            one.answer.document.group = Some(judged.clone());
        }
    }
    Ok(groups)
}
