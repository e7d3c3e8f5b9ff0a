"""Commands of ``mdms``: module ``NAME.py`` holds function ``NAME``, imported on demand.

The function's parameters are typer's options. Its docstring is the help: rich's markup, indented lines stay
lines, no ``Args``. A command ends by returning (exit status 0), by ``raise typer.Exit(status)``, or by an
error of one of the packages, which ``deploy.cli`` turns into one line and an exit status.
"""
