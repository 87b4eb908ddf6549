"""Speed against accuracy on a scene of the user's: what each rung, layout and density takes and gets wrong.

``plan`` says what is swept; ``reference`` knows the right answers; ``survey`` looks at every point once and
compares its picture (``pictures``) and its answers to rays (``errors``); ``contest`` measures in turns
(``turns``), and ``choose`` takes one point; ``front`` and ``report`` make the record, ``words`` the sentence.
"""

from clgrid.tradeoff.plan import Plan, Wish
from clgrid.tradeoff.run import tradeoff

__all__ = ["Plan", "Wish", "tradeoff"]
