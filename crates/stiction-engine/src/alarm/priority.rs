//! Priority of alarms.

use serde::{Deserialize, Serialize};

use stiction::core::ident::region::Size;

/// Priority of an alarm (ISA-18.2).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Priority {
    /// When there is time.
    Low,
    /// At the next opportunity.
    Medium,
    /// Before others.
    High,
    /// First of all.
    Urgent,
}

impl Priority {
    /// Default criticality of a loop.
    pub const CRITICALITY: u8 = 3;

    /// The priority for a stiction class on a loop of this criticality (1 to 5, default 3). At 3, weak is low, moderate medium,
    /// strong high; two steps of criticality change it by one.
    #[must_use]
    pub fn of(class: Option<Size>, criticality: u8) -> Self {
        let twice = match class {
            Some(Size::Strong) => 6,
            Some(Size::Moderate) => 4,
            Some(Size::Weak | Size::None) | None => 2,
        };
        let doubled = twice + i32::from(criticality) - 3;
        match doubled {
            ..4 => Self::Low,
            4 | 5 => Self::Medium,
            6 | 7 => Self::High,
            _ => Self::Urgent,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn priority_grows_with_the_class_and_the_criticality() {
        let row = |criticality| CLASSES.map(|class| Priority::of(Some(class), criticality));
        assert_eq!(row(3), [Priority::Low, Priority::Medium, Priority::High]);
        assert_eq!(row(1), [Priority::Low, Priority::Low, Priority::Medium]);
        assert_eq!(row(5), [Priority::Medium, Priority::High, Priority::Urgent]);
        assert!((1..5).all(|c| row(c) <= row(c + 1)) && row(4)[0] <= row(4)[1]);
    }

    const CLASSES: [Size; 3] = [Size::Weak, Size::Moderate, Size::Strong];
}
