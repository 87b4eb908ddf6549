"""The same work on several devices: how fast each is, and where their answers differ.

``run`` starts a process a device (``process``), which does what its order says (``child``, ``work``,
``properties``); what they say to each other is in ``messages``, arrays go through ``files``. ``differences``
compares them.
"""

from clgrid.compare.plan import Plan
from clgrid.compare.run import broken_promises, compare, unfinished

__all__ = ["Plan", "broken_promises", "compare", "unfinished"]
