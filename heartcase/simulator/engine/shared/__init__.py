"""What the engines share: the layout of nodes in lanes, and contact with probes."""
