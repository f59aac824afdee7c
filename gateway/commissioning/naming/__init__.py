"""`talc-gateway name`: which sensor is which, by warming one after the other."""
