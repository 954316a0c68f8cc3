//! The groups of loops that share one oscillation, with their members at the latest comparisons.

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, PoisonError};
use std::time::Instant;

use serde::Serialize;

use super::Overview;
use stiction::core::units::ms_from_ns;
use stiction::plantwide::{GroupDocument, SourceKind};

/// Comparisons of a group whose members are kept.
const COMPARISONS_KEPT: usize = 200;
/// Ended groups whose members are kept, in case the groups return.
const ENDED_KEPT: usize = 64;

/// The members of a group at one comparison.
#[derive(Debug, Clone, PartialEq, Serialize, schemars::JsonSchema)]
pub struct Membership {
    /// End of the compared time, ms since 1970.
    pub t_ms: f64,
    /// Names of the loops, the likeliest source first.
    pub members: Vec<String>,
    /// The loop that causes the oscillation; null if none is named.
    pub source: Option<String>,
}

/// A current group, with its members over time.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct ShownGroup {
    /// A number that the group keeps while its members stay together; numbers start again with the daemon.
    pub id: u64,
    /// The newest document.
    #[serde(serialize_with = "as_itself")]
    pub document: Arc<GroupDocument>,
    /// The newest comparisons that found it, oldest first.
    pub history: Vec<Membership>,
}

fn as_itself<S: serde::Serializer>(document: &Arc<GroupDocument>, serializer: S) -> Result<S::Ok, S::Error> {
    document.as_ref().serialize(serializer)
}

/// The groups of the newest comparison.
#[derive(Debug, Clone, Serialize, schemars::JsonSchema)]
pub struct ShownGroups {
    /// Seconds since the newest comparison; null before the first.
    pub compared_age_s: Option<f64>,
    /// Its groups.
    pub groups: Vec<ShownGroup>,
}

/// A group over time.
#[derive(Debug)]
struct Track {
    id: u64,
    /// `None` if the newest comparison did not find it.
    document: Option<Arc<GroupDocument>>,
    history: VecDeque<Membership>,
}

impl Track {
    fn common(&self, members: &[String]) -> usize {
        let newest = self.history.back();
        newest.map_or(0, |newest| newest.members.iter().filter(|name| members.contains(name)).count())
    }

    fn take(&mut self, document: Arc<GroupDocument>) {
        if self.history.len() == COMPARISONS_KEPT {
            self.history.pop_front();
        }
        let source = &document.source;
        self.history.push_back(Membership {
            t_ms: ms_from_ns(document.window.end_ns),
            members: document.members.clone(),
            source: source.loop_name.clone().filter(|_| source.kind == SourceKind::Loop),
        });
        self.document = Some(document);
    }
}

/// All remembered groups.
#[derive(Debug, Default)]
pub(super) struct Groups {
    tracks: Vec<Track>,
    next_id: u64,
    compared: Option<Instant>,
    /// Version of the newest comparison.
    pub(super) changed: u64,
}

impl Groups {
    /// Takes the groups of a comparison: each continues the group that had most of its members.
    fn take(&mut self, now: Instant, groups: Vec<Arc<GroupDocument>>) {
        self.compared = Some(now);
        let mut pairs: Vec<(usize, usize, usize)> = Vec::new();
        for (g, group) in groups.iter().enumerate() {
            let common = self.tracks.iter().enumerate().map(|(t, track)| (track.common(&group.members), g, t));
            pairs.extend(common.filter(|(common, ..)| *common > 0));
        }
        pairs.sort_by_key(|pair| std::cmp::Reverse(pair.0));
        let mut of_group = vec![None; groups.len()];
        for (_, g, t) in pairs {
            if of_group[g].is_none() && !of_group.contains(&Some(t)) {
                of_group[g] = Some(t);
            }
        }
        self.tracks.iter_mut().for_each(|track| track.document = None);
        for (group, track) in groups.into_iter().zip(of_group) {
            let t = track.unwrap_or_else(|| {
                self.tracks.push(Track { id: self.next_id, document: None, history: VecDeque::new() });
                self.next_id += 1;
                self.tracks.len() - 1
            });
            self.tracks[t].take(group);
        }
        let mut too_many = self.tracks.iter().filter(|t| t.document.is_none()).count().saturating_sub(ENDED_KEPT);
        self.tracks.retain(|track| {
            let goes = track.document.is_none() && too_many > 0;
            too_many -= usize::from(goes);
            !goes
        });
    }

    fn shown(&self, now: Instant) -> ShownGroups {
        let shown = self.tracks.iter().filter_map(|track| {
            let history = track.history.iter().cloned().collect();
            Some(ShownGroup { id: track.id, document: track.document.clone()?, history })
        });
        ShownGroups {
            compared_age_s: self.compared.map(|then| now.saturating_duration_since(then).as_secs_f64()),
            groups: shown.collect(),
        }
    }
}

impl Overview {
    /// Sets the groups of a new comparison.
    pub fn show_groups(&self, now: Instant, groups: Vec<Arc<GroupDocument>>) {
        let judged = groups.iter().flat_map(|group| &group.judgements);
        let causes: HashMap<&str, &String> =
            judged.filter_map(|judged| Some((judged.loop_name.as_str(), judged.cause.as_ref()?))).collect();
        let mut loops = self.0.write().unwrap_or_else(PoisonError::into_inner);
        loops.version += 1;
        let version = loops.version;
        for (name, entry) in &mut loops.by_name {
            let driven = causes.get(name.as_ref()).copied();
            if entry.driven.as_ref() != driven {
                entry.driven = driven.cloned();
                entry.changed = version;
            }
        }
        loops.groups.changed = version;
        drop(causes);
        loops.groups.take(now, groups);
    }

    /// The groups of the newest comparison.
    #[must_use]
    pub fn groups(&self, now: Instant) -> ShownGroups {
        self.0.read().unwrap_or_else(PoisonError::into_inner).groups.shown(now)
    }
}
