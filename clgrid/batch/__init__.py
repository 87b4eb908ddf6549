"""Jobs: many pictures of many scenes, nothing lost.

A ``job`` becomes items (``plan``), one picture each; a child process draws them (``worker``, ``painter``),
and is kept and replaced by ``keeper``; ``run`` goes through the items and notes what became of each.
"""
