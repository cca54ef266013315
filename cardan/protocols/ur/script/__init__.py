"""URScript: `parse` converts a program's text to a tree, or reports the part that it does not
understand.

Supported are programs (`def NAME():` and `sec NAME():`) and single commands without either;
functions and threads inside them; `global` and `local`; assignments also to elements and members;
`if`, `while`, `switch`; `break`, `continue`, `return`, `halt`, `pass`; `run`, `join`, `kill`;
`enter_critical` and `exit_critical`; numbers, texts, True and False, lists, matrices, poses
`p[...]`, `struct(...)`; ``+ - * / % == != < <= > >= not and or xor``. Source: UR's script manual
(public). It does not define continuation lines: existing programs continue lines after an operator,
after `=`, and inside brackets.
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
