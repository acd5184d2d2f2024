"""Where cameras were, better than they knew: their pictures and depths against those of what all of them saw."""
