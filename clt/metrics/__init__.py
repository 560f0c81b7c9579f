"""How good an estimate is: association, alignment, errors, consistency."""
