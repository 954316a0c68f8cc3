//! A second, simpler model of the alarm after ISA-18.2, with lists and flags instead of bits and states.
#![allow(dead_code)] // each test uses a part of it

use stiction_engine::alarm::MAX_SHELVE_S;

/// Most windows that an m-of-n rule considers.
const REMEMBERED: usize = 32;

/// The state as people should see it.
#[derive(Debug, Default, Clone, PartialEq)]
pub struct Model {
    /// Informative windows since the condition changed: for, against or neither.
    pub informative: Vec<char>,
    pub active: bool,
    pub needs_ack: bool,
    pub class: usize,
    pub worse: usize,
    pub shelf_ends_ns: Option<i64>,
    pub suppressed: bool,
    pub out_of_service: bool,
}

impl Model {
    pub fn shown(&self) -> &'static str {
        match (self.active, self.needs_ack) {
            _ if self.out_of_service => "out_of_service",
            _ if self.suppressed => "suppressed",
            _ if self.shelf_ends_ns.is_some() => "shelved",
            (true, true) => "unack",
            (true, false) => "acked",
            (false, true) => "rtn_unack",
            (false, false) => "normal",
        }
    }

    /// Votes of one kind among the last n informative windows.
    fn votes(&self, kind: char, n: usize) -> usize {
        self.informative.iter().rev().take(n).filter(|v| **v == kind).count()
    }

    /// Takes a window; true if it changes the displayed state.
    pub fn window(&mut self, end_ns: i64, vote: Option<char>, class: usize, [m, n]: [usize; 2]) -> bool {
        let off_the_shelf = self.shelf_ends_ns.is_some_and(|ends| end_ns >= ends);
        if off_the_shelf {
            self.shelf_ends_ns = None;
        }
        let Some(vote) = vote else { return off_the_shelf };
        self.informative.push(vote);
        if self.informative.len() > REMEMBERED {
            self.informative.remove(0);
        }
        if !self.active && vote == 'f' && self.votes('f', n) >= m {
            (self.active, self.needs_ack, self.class, self.worse) = (true, true, class, 0);
            self.informative.iter_mut().filter(|v| **v == 'a').for_each(|v| *v = '-');
            return true;
        }
        if self.active && self.votes('a', n) >= m {
            self.active = false;
            self.informative.iter_mut().filter(|v| **v == 'f').for_each(|v| *v = '-');
            return true;
        }
        self.worse = if self.active && vote == 'f' && class > self.class { self.worse + 1 } else { 0 };
        if self.worse == 2 {
            (self.worse, self.class, self.needs_ack) = (0, class, true);
            return true;
        }
        off_the_shelf
    }

    /// Takes a command; true if it is accepted.
    pub fn command(&mut self, cmd: &str, for_s: Option<u64>, at_ns: i64) -> bool {
        let flip = |flag: &mut bool, to: bool| std::mem::replace(flag, to) != to;
        match cmd {
            "ack" => flip(&mut self.needs_ack, false),
            "shelve" => {
                let seconds = for_s.unwrap_or(8 * 3600);
                let taken = self.shelf_ends_ns.is_none() && seconds > 0 && seconds <= MAX_SHELVE_S;
                if taken {
                    self.shelf_ends_ns = Some(at_ns.saturating_add(seconds as i64 * 1_000_000_000));
                }
                taken
            }
            "unshelve" => self.shelf_ends_ns.take().is_some(),
            "suppress" => flip(&mut self.suppressed, true),
            "unsuppress" => flip(&mut self.suppressed, false),
            "out_of_service" => flip(&mut self.out_of_service, true),
            "in_service" => flip(&mut self.out_of_service, false),
            _ => false,
        }
    }
}
