"""Messages of the machines of a site, as a read-only subscriber holds them."""
