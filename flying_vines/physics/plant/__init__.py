"""The high-fidelity plant: the baseline plus the effects that the baseline leaves out.

`effects.Effects` lists the effects of a rig, and `plant.Plant` is the rig with these effects. `numbers`
converts a plant to plain numbers, `rates` has its differential equations, and `sensors` computes the
readings. `simulator.Simulator` runs a plant tick by tick; `compiled` runs many ticks in one call. Without
effects the plant is the baseline. EVP is the inflation valve, DVP the valve that supplies the Venturi.
"""
