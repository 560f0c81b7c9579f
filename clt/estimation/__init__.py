"""A recording and a start in, a result out: the table of filters, the judge of a run, replays."""
