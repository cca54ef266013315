"""Throws damaged input at everything that turns foreign bytes or text into values.

``python -m fuzz`` runs all targets, ``python -m fuzz --list`` names them; docs/beyond-make-test.md
is the page about it. A *target* (:mod:`fuzz.target`) is one such function, or one machine with a
state that is fed packets; it is declared beside others of its kind in :mod:`fuzz.targets`. Input is
made by damaging good and kept input (:mod:`fuzz.mutate`, :mod:`fuzz.corpus`), by a number that can
be given again.
"""
