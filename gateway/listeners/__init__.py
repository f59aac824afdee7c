"""Programs that only listen to gateways: the page, the OPC UA server, the outlets, the collector of a site."""
