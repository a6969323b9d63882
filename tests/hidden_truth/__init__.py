"""A proving ground: recorded runs of rigs that hide an effect, made by a simulator of its own.

It is written from the definitions in words of the rig, the files and the causes, and shares neither code
nor numbers with `flying_vines`: where the two agree, they agree because both are right.

    truth = draw("clear", seed=7)           what is hidden, in which rig, flown how
    runs = make(truth)                      the recorded runs
    answer = write(folder, truth)           rig.toml and the runs; the answer goes one level up

| file | what is in it |
| --- | --- |
| `kernel` | equations and integrator: one run of one rig, with whatever it hides |
| `rig` | the rig's numbers, true or believed, and `rig.toml` |
| `effects` | every effect by name: how it enters the equations, how strong it is on real rigs |
| `plans` | what is done in a run: steps, random openings, bends, hold, discharge |
| `truth`, `recording` | what is hidden · the runs that come of it |
| `gap` | how far the best fit of the baseline stays behind the truth |
| `draw` | the tiers: clear, subtle, faint, worn, holes, short, pair, null, outside, hard, several, … |
| `files` | the public format |
"""

from hidden_truth.draw import TIERS, draw
from hidden_truth.files import answer, write
from hidden_truth.recording import make

__all__ = ["TIERS", "answer", "draw", "make", "write"]
