"""Protocol reports of a run: residuals, rate against theory, load on links, plot of the field."""
