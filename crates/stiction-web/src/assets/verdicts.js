// The texts of verdicts, from crates/stiction-core/src/verdict/texts.rs; a test compares them.

export const VERDICTS = {
  stiction: { short: "sticks", words: "the valve sticks and slips" },
  deadband: { short: "dead band", words: "the valve has a dead band" },
  disturbance: { short: "disturbed", words: "the loop oscillates, most likely because of an external disturbance" },
  tuning: { short: "tuning", words: "the loop oscillates, most likely because of its tuning" },
  cause_unknown: { short: "oscillates", words: "the loop oscillates; the cause was not identified" },
  not_oscillating: { short: "steady", words: "no regular oscillation" },
  inconclusive: { short: "no answer", words: "not enough evidence for a verdict" },
};
