"""SINUMERIK controls over OPC UA."""
