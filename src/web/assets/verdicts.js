// The texts of verdicts and of NE 107's signs, from the program's own lists; a test compares them.

export const VERDICTS = {
  stiction: { short: "sticks", words: "the valve sticks and slips" },
  deadband: { short: "dead band", words: "the valve has a dead band" },
  disturbance: { short: "disturbed", words: "the loop oscillates, most likely because of an external disturbance" },
  tuning: { short: "tuning", words: "the loop oscillates or follows its set point badly, most likely because of its tuning" },
  cause_unknown: { short: "oscillates", words: "the loop oscillates; the cause was not identified" },
  not_oscillating: { short: "steady", words: "no regular oscillation" },
  inconclusive: { short: "no answer", words: "not enough evidence for a verdict" },
};

export const SIGNS = {
  M: { name: "maintenance required", says: "stiction alarm active" },
  F: { name: "failure of the signal", says: "signal frozen, bad or missing" },
  S: { name: "out of specification", says: "oscillates, or sticks without an alarm" },
  C: { name: "function check", says: "in manual or out of service" },
  none: { name: "nothing found", says: "no oscillation and no sign of stiction found" },
};
