"""The words for every diagnostic: the only place where what algorithms found becomes English."""
