"""Pieces of neighbour protocols, to be composed in the program of a cell.

Each piece is a few functions of plain numbers, decorated with ``scalar_function``: a program in plain Python calls
them, and a program in scalar form is compiled with them. Values of the four sides are a sequence of four, in the order
of ``bus.lattice.SIDES``: a tuple, a list, or an array of the state's record. Whole numbers in records should have the
type ``<i8``, since narrow types wrap in Python. The page on the kit has the theorem of each piece.
"""
