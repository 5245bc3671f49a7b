"""The cases of the suite, by what they are about."""
from . import faults, nodes, plugs, twins

CASES = faults.CASES + plugs.CASES + nodes.CASES + twins.CASES
