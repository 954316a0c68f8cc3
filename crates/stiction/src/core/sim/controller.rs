//! The controller: PI and PID in the standard (ISA) form, with limits, anti-windup, manual mode and bumpless changes.
//!
//! `OP = +-Kc (e + 1/Ti * integral of e dt) -+ Kc Td dPV/dt` (Åström & Hägglund 1995, ch. 3): the derivative acts on filtered
//! PV only, and the integral stops where it brings OP to its limit (conditional integration).

use super::noise::quantise;

/// Direction of OP when PV rises.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// OP falls: for processes of positive gain.
    Reverse,
    /// OP rises: for processes of negative gain.
    Direct,
}

/// Settings of a controller.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PidSettings {
    /// Gain, OP units per PV unit, > 0; the sign is in `action`.
    pub kc: f64,
    /// Integral time, s; infinite for none.
    pub ti_s: f64,
    /// Derivative time, s; 0 for none.
    pub td_s: f64,
    /// Action.
    pub action: Action,
    /// Least OP.
    pub op_min: f64,
    /// Greatest OP.
    pub op_max: f64,
    /// OP is rounded to multiples of this (a 13-bit 4..20 mA output has about 0.01 %); 0 for no rounding.
    pub op_resolution: f64,
}

/// The derivative's filter has the time constant `td_s / DERIVATIVE_LIMIT`.
pub(crate) const DERIVATIVE_LIMIT: f64 = 10.0;

/// A controller with its state.
#[derive(Debug, Clone)]
pub struct Pid {
    settings: PidSettings,
    /// Integral part, bias included, OP units.
    integral: f64,
    derivative: f64,
    last_pv: f64,
    op: f64,
    manual: bool,
}

impl Pid {
    /// A controller in automatic that takes over bumplessly: its first OP is `op` plus the integral of one scan.
    #[must_use]
    pub fn bumpless(settings: PidSettings, op: f64, sp: f64, pv: f64) -> Self {
        let op = op.clamp(settings.op_min, settings.op_max);
        let mut pid = Self { settings, integral: 0.0, derivative: 0.0, last_pv: pv, op, manual: false };
        pid.take_over(sp, pv);
        pid
    }

    /// The last OP.
    #[must_use]
    pub const fn op(&self) -> f64 {
        self.op
    }

    /// Whether it is in manual.
    #[must_use]
    pub const fn is_manual(&self) -> bool {
        self.manual
    }

    /// Switches to manual with OP at `op`, or at its current value.
    pub fn set_manual(&mut self, op: Option<f64>) {
        self.manual = true;
        if let Some(op) = op {
            self.op = op.clamp(self.settings.op_min, self.settings.op_max);
        }
    }

    /// Switches back to automatic; OP continues from its current value.
    pub(crate) const fn set_auto(&mut self) {
        self.manual = false;
    }

    fn signed_gain(&self) -> f64 {
        match self.settings.action {
            Action::Reverse => self.settings.kc,
            Action::Direct => -self.settings.kc,
        }
    }

    /// Sets the integral part so that OP keeps its current value.
    fn take_over(&mut self, sp: f64, pv: f64) {
        self.integral = self.op - self.signed_gain() * (sp - pv) - self.derivative;
    }

    /// OP of this scan, `dt_s` seconds after the last.
    pub fn step(&mut self, sp: f64, pv: f64, dt_s: f64) -> f64 {
        let PidSettings { ti_s, td_s, op_min, op_max, op_resolution, .. } = self.settings;
        let gain = self.signed_gain();
        let filter_s = td_s / DERIVATIVE_LIMIT;
        self.derivative = if td_s > 0.0 {
            (filter_s * self.derivative - gain * td_s * (pv - self.last_pv)) / (filter_s + dt_s)
        } else {
            0.0
        };
        self.last_pv = pv;
        if self.manual {
            self.take_over(sp, pv);
            return self.op;
        }
        let fast = gain * (sp - pv) + self.derivative;
        let more = gain * (sp - pv) * dt_s / ti_s;
        // Integrates up to the limit, so that OP comes to rest at the limit, not short of it.
        let (room_down, room_up) = (op_min - fast - self.integral, op_max - fast - self.integral);
        self.integral += more.clamp(room_down.min(0.0), room_up.max(0.0));
        self.op = quantise(fast + self.integral, op_resolution).clamp(op_min, op_max);
        self.op
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PI: PidSettings = PidSettings {
        kc: 2.0,
        ti_s: 10.0,
        td_s: 0.0,
        action: Action::Reverse,
        op_min: 0.0,
        op_max: 100.0,
        op_resolution: 0.0,
    };

    #[test]
    fn a_constant_error_gives_the_textbook_ramp() {
        let mut pid = Pid::bumpless(PI, 40.0, 50.0, 50.0);
        // A step of the error by 1: proportional part at once, then Kc/Ti a second.
        for k in 1..=20 {
            let op = pid.step(51.0, 50.0, 1.0);
            assert!((op - (40.0 + 2.0 + 0.2 * f64::from(k))).abs() < 1e-12);
        }
    }

    #[test]
    fn op_is_sent_in_steps_but_integrates_finely() {
        let mut pid = Pid::bumpless(PidSettings { op_resolution: 0.5, ..PI }, 40.0, 50.0, 50.0);
        let ops: Vec<f64> = (0..5).map(|_| pid.step(50.5, 50.0, 1.0)).collect();
        // 41.1, 41.2, 41.3, 41.4, 41.5 before rounding.
        assert_eq!(ops, [41.0, 41.0, 41.5, 41.5, 41.5]);
    }

    #[test]
    fn the_action_turns_the_answer_around() {
        let mut reverse = Pid::bumpless(PI, 40.0, 50.0, 50.0);
        let mut direct = Pid::bumpless(PidSettings { action: Action::Direct, ..PI }, 40.0, 50.0, 50.0);
        let (down, up) = (reverse.step(50.0, 51.0, 1.0), direct.step(50.0, 51.0, 1.0));
        assert!((down - 37.8).abs() < 1e-12 && (up - 42.2).abs() < 1e-12);
    }

    #[test]
    fn the_derivative_of_a_ramp_settles_at_its_slope() {
        let mut pid = Pid::bumpless(PidSettings { ti_s: f64::INFINITY, td_s: 5.0, ..PI }, 50.0, 0.0, 0.0);
        let mut op = 0.0;
        for k in 1..=200 {
            let pv = 0.1 * f64::from(k);
            op = pid.step(pv, pv, 1.0);
        }
        // e = 0 throughout, so only -Kc Td dPV/dt is left.
        assert!((op - (50.0 - 2.0 * 5.0 * 0.1)).abs() < 1e-9);
    }

    #[test]
    fn op_leaves_its_limit_as_soon_as_the_error_turns() {
        let mut pid = Pid::bumpless(PI, 90.0, 50.0, 50.0);
        for _ in 0..1_000 {
            pid.step(60.0, 50.0, 1.0);
        }
        assert_eq!(pid.op(), 100.0);
        // Without anti-windup the integral would hold OP at 100 for about 1,000 scans.
        assert!(pid.step(49.0, 50.0, 1.0) < 99.0);
        for _ in 0..1_000 {
            pid.step(0.0, 50.0, 1.0);
        }
        assert_eq!(pid.op(), 0.0);
        assert!(pid.step(51.0, 50.0, 1.0) > 1.0);
    }

    #[test]
    fn taking_over_and_coming_back_from_manual_are_bumpless() {
        let mut pid = Pid::bumpless(PI, 33.0, 80.0, 20.0);
        assert!((pid.step(80.0, 20.0, 1.0) - (33.0 + 0.2 * 60.0)).abs() < 1e-9);
        let mut pid = Pid::bumpless(PI, 33.0, 50.0, 49.0);
        pid.set_manual(Some(60.0));
        for k in 0..30 {
            assert_eq!(pid.step(50.0, 49.0 + 0.1 * f64::from(k), 1.0), 60.0);
        }
        pid.set_auto();
        // Only one scan's integral and no jump.
        let op = pid.step(50.0, 51.9, 1.0);
        assert!((op - (60.0 + 0.2 * (50.0 - 51.9))).abs() < 1e-9, "{op}");
        pid.set_manual(None);
        assert!(pid.is_manual() && pid.step(0.0, 0.0, 1.0) == op);
    }
}
