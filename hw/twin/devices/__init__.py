"""Serial ports and cameras that agents open, with the twin behind them."""
