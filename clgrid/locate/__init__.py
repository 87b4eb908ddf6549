"""Where two devices part on a ray: the first value that differs, what computes it, and which of them errs.

CONTROL FLOW. ``locate`` starts a child process a side (``sides``, ``child``), since a driver may take its
process along. Each builds the grid, casts the ray as ever, and traces it (``trace``, cl/trace_ray.cl): the
functions of the casting kernels' headers, called step by step, and what they give written down as bits. The
traces are compared value by value (``difference``) by a table of what they hold (``stages``); how a value may
have come about, exact arithmetic tells (``arithmetic``, of the numbers in ``setting``); ``wording`` says it.
``write_repro`` keeps it all in one file, with as few triangles as still show it (``meshes``), and ``replay``
runs that (``repro``).
"""

from __future__ import annotations

from clgrid.locate.finding import Finding as Finding
from clgrid.locate.finding import locate as locate
from clgrid.locate.repro import read_repro as read_repro
from clgrid.locate.repro import replay as replay
from clgrid.locate.repro import write_repro as write_repro
from clgrid.locate.sides import Side as Side
