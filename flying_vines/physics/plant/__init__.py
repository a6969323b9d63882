"""The high-fidelity plant: the baseline and what it leaves out, one effect a file.

`effects.Effects` says which effects a rig has, `plant.Plant` is the rig with them, `numbers` are what it
comes to, `rates` is its right-hand side. `simulator.Simulator` lives it tick by tick, `compiled` many of them
at once; `sensors` reads it, `causes` names it. With no effects it is the baseline.
"""
