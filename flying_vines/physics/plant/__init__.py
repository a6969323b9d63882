"""The high-fidelity plant: the baseline plus the effects that it leaves out.

`effects.Effects` lists the effects of a rig, `plant.Plant` is the rig with them. `numbers` converts a plant
to plain numbers, `rates` is its right-hand side, `sensors` reads it. `simulator.Simulator` runs it tick by
tick, `compiled` whole runs at once. Without effects the plant is the baseline. EVP is the inflation valve,
DVP the valve that supplies the Venturi.
"""
