"""From where the device points to where the person walks."""
