"""Recorded runs of rigs with hidden effects, from an independent simulator.

It was written from definitions in words: of the rig, of the files and of the causes. It shares no code and no
numbers with `flying_vines`. So an error in either of the two shows as a difference.

    truth = draw("clear", seed=7)           the hidden effects, the rig, the runs
    runs = make(truth)                      the recorded runs
    answer = write(folder, truth)           rig.toml and the runs; the answer is written beside the folder

| file | contents |
| --- | --- |
| `kernel` | equations and integrator: one run of one rig, with its hidden effects |
| `rig` | the rig's numbers, true or nominal, and `rig.toml` |
| `effects` | every effect by name: its place in the equations, its strength on real rigs |
| `plans` | the inputs of a run: steps, random openings, bends, hold, discharge |
| `truth`, `recording` | the hidden effects · the recorded runs |
| `gap` | how much worse the best fit of the baseline is than the truth |
| `draw` | the tiers: clear, subtle, faint, worn, holes, short, pair, null, outside, hard, several, … |
| `files` | the public format |
"""

from hidden_truth.draw import TIERS, draw
from hidden_truth.files import answer, write
from hidden_truth.recording import make

__all__ = ["TIERS", "answer", "draw", "make", "write"]
