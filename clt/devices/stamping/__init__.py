"""When samples were true, by the clock of the host."""
