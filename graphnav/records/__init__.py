"""What a log is made of, one class per sensor; users find them in `graphnav.log`."""
