"""Radio maps: positions of Wi-Fi scans, estimated from walks with known positions."""
