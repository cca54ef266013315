"""URScript: `parse` turns a program's text into a tree, or says what of it is not understood.

Known are programs (`def NAME():` and `sec NAME():`) and single commands without either; functions
and threads inside them; `global` and `local`; assignments also to elements and members; `if`,
`while`, `switch`; `break`, `continue`, `return`, `halt`, `pass`; `run`, `join`, `kill`;
`enter_critical` and `exit_critical`; numbers, texts, True and False, lists, matrices, poses
`p[...]`, `struct(...)`; ``+ - * / % == != < <= > >= not and or xor``.

Source: UR's script manual (public). Where a line goes on is not in it: programs in use go on after
an operator, after `=`, and inside brackets.
"""

from cardan.protocols.ur.script.lexer import LARGEST, LARGEST_WHOLE
from cardan.protocols.ur.script.parser import DEEPEST, parse, parsed
from cardan.protocols.ur.script.portions import pause, whole
from cardan.protocols.ur.script.tree import ParseFailure, Program

__all__ = [
    "DEEPEST",
    "LARGEST",
    "LARGEST_WHOLE",
    "ParseFailure",
    "Program",
    "parse",
    "parsed",
    "pause",
    "whole",
]
