"""GenApi from the camera's side: what the nodes of a GenICam description say about the registers behind them."""
