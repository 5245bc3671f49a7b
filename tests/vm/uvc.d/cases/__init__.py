"""The cases of the suite, by what they are about."""
from . import faults, nodes, plugs, twins, unusable

CASES = faults.CASES + plugs.CASES + nodes.CASES + twins.CASES + unusable.CASES
