"""Studies: a grid of scenarios, settings and seeds in, tables out."""
