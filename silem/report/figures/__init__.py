"""Every figure that is drawn from runs: a table of `silem.report.results` in, a figure out."""
