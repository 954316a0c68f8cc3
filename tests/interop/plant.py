"""A small plant for the interoperability tests, independent of the program under test."""

import math
import random
from dataclasses import dataclass, field


@dataclass
class Loop:
    """A valve with He's law, a first-order process with dead time, a PI controller; one scan a second."""

    fs: float = 0.0
    fd: float = 0.0
    gain: float = 2.0
    tau_s: float = 20.0
    dead_time_s: int = 6
    kc: float = 0.8
    ti_s: float = 8.0
    noise: float = 0.05
    sine: float = 0.0  # amplitude of a disturbance at the process input, period 90 s
    seed: int = 1
    op: list = field(default_factory=list)
    pv: list = field(default_factory=list)

    def run(self, scans, warm_up=900):
        rng = random.Random(self.seed)
        a = math.exp(-1.0 / self.tau_s)
        delayed = [0.0] * (self.dead_time_s + 1)
        x, stem, op, last_error = 0.0, 0.0, 0.0, None
        for k in range(warm_up + scans):
            delayed = [stem] + delayed[:-1]
            disturbance = self.sine * math.sin(2 * math.pi * k / 90.0)
            x = a * x + (1 - a) * self.gain * (delayed[-1] + disturbance)
            pv = x + rng.gauss(0.0, self.noise)
            error = (1.0 if k > 50 else 0.0) - pv
            op += self.kc * (error - (error if last_error is None else last_error)) + self.kc / self.ti_s * error
            last_error = error
            push = op - stem
            if abs(push) > self.fs:
                stem = op - math.copysign(self.fd, push)
            if k >= warm_up:
                self.op.append(50.0 + op)
                self.pv.append(60.0 + pv)
        return self
