"""The commands of ``mdms``: module ``NAME.py`` holds function ``NAME``, imported only when it is called for.

The function's parameters are typer's options; its docstring is the help, in rich's markup, and has no ``Args``.
Lines that are indented in it stay lines. A command ends by returning (exit status
0), by ``raise typer.Exit(status)``, or by an error of one of the packages, which ``deploy.cli`` turns into
one line and an exit status.
"""
