//! `analyze --plant`: the groups of loops that share an oscillation, as text.

use stiction::plantwide::{GroupDocument, text};

/// All groups, and the number of loops in none of them.
pub(super) fn groups_text(groups: &[GroupDocument], loops: usize) -> String {
    if groups.is_empty() {
        return format!("\nOf {loops} loops no two share an oscillation: each loop's own answer counts.");
    }
    let each: String = groups.iter().map(|group| format!("\n{}\n", text(group))).collect();
    let grouped: usize = groups.iter().map(|group| group.members.len()).sum();
    match loops - grouped {
        0 => each,
        alone => each + &format!("\n{alone} of {loops} loops are in no group: their own answers count."),
    }
}
