"""Where a parcel is, from the sensors and the messages of the cells under it: what protocols that need it share."""
