"""Reports: records as pages, tables, plots and files, and two records beside one another.

``read`` takes a record from a file; ``pages`` say what is shown of it, in terms of ``model``; ``html``,
``svg``, ``plot`` and ``csvfile`` write that down. ``entries``, ``match``, ``noise``, ``rules`` and
``difference`` compare two records.
"""
