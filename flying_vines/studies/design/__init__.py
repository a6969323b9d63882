"""The paper's design guide as a tool: evaluates and chooses the parts of a phloSAR for a robot.

robot = demonstration()                     or robot.load(path)
parts = catalogue()                         or catalogue(folder, ...)
evaluation = evaluate(robot, parts.choose(robot.parts))
front = search(robot, parts)                Pareto front of mass and cycles, as evaluations
"""

from flying_vines.studies.design.evaluate import Evaluation, evaluate, search
from flying_vines.studies.design.parts import Catalogue, PartsChoice, catalogue
from flying_vines.studies.design.robot import Robot, demonstration

__all__ = [
    "Catalogue",
    "Evaluation",
    "PartsChoice",
    "Robot",
    "catalogue",
    "demonstration",
    "evaluate",
    "search",
]
