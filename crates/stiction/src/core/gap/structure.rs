//! What is fitted: the base, and which effects are added to it.

use super::candidate::{MAX_PARAMS, Parameters};
use super::effects::{Effect, Param, Reach};
use super::plan::Plan;
use super::problem::Problem;
use crate::core::sim::slips::Law;

/// Base and the effects added to it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Structure {
    /// Law of the base.
    pub law: Option<Law>,
    /// Up to two effects.
    pub effects: [Option<&'static Effect>; 2],
}

/// Id of a structure without an effect.
pub(crate) const BASE: &str = "base";

impl Structure {
    /// The base alone.
    #[must_use]
    pub(crate) const fn base(law: Option<Law>) -> Self {
        Self { law, effects: [None; 2] }
    }

    /// Base and one effect.
    #[must_use]
    pub(crate) const fn with(law: Option<Law>, effect: &'static Effect) -> Self {
        Self { law, effects: [Some(effect), None] }
    }

    /// The effects, in order.
    pub(crate) fn each(&self) -> impl Iterator<Item = &'static Effect> + '_ {
        self.effects.iter().flatten().copied()
    }

    /// The id in documents.
    #[must_use]
    pub(crate) fn id(&self) -> String {
        let ids: Vec<&str> = self.each().map(|e| e.id).collect();
        if ids.is_empty() { BASE.to_owned() } else { ids.join("+") }
    }

    /// The id in documents, with the name of the problem's neighbour.
    #[must_use]
    pub(crate) fn id_in(&self, problem: &Problem) -> String {
        let named: Vec<String> = self.each().map(|e| e.id_in(problem)).collect();
        if named.is_empty() { self.id() } else { named.join("+") }
    }

    /// All parameters, in the order of [`Parameters::p`].
    pub(crate) fn params(&self) -> impl Iterator<Item = &'static Param> + '_ {
        self.each().flat_map(|e| e.params.iter()).take(MAX_PARAMS)
    }

    /// Lets the rest of a parameter vector give way to a change `by` of its parameter `at`, as far as a model trades one
    /// for the other.
    pub(crate) fn trade(&self, theta: &mut Parameters, at: usize, by: f64, op_rate: f64) {
        if let Some(param) = self.params().nth(at) {
            (param.trade)(theta, at, by, op_rate);
        }
    }

    /// The plan that a theta's parameters make.
    #[must_use]
    pub(crate) fn plan(&self, theta: &Parameters) -> Plan {
        self.plan_of(&theta.p)
    }

    /// The plan that these parameters make.
    #[must_use]
    pub(crate) fn plan_of(&self, p: &[f64; MAX_PARAMS]) -> Plan {
        let mut plan = Plan::base(self.law);
        let mut at = 0;
        for effect in self.each() {
            let end = (at + effect.params.len()).min(MAX_PARAMS);
            (effect.apply)(&p[at..end], &mut plan);
            at = end;
        }
        plan
    }

    /// Sets the parameter that is the logarithm of the second lag, where there is one.
    pub(crate) fn set_second_lag(&self, theta: &mut Parameters, log: f64) {
        if let Some(at) = self.params().position(|p| p.reach == Reach::SecondLag) {
            theta.p[at] = log;
        }
    }

    /// Free parameters of a model: bands, first slip, process, effects, linear ones.
    #[must_use]
    pub(crate) fn freedom(&self, plan: &Plan) -> usize {
        let friction = if plan.law.is_some() { 3 } else { 0 };
        let lags = if plan.integrating { 1 } else { 2 };
        // Gain, constant and memory.
        let linear = 3 + usize::from(plan.tau2 > 0.0) + plan.extras();
        friction + lags + linear + self.params().count()
    }
}
