"""What everything that runs needs: clocks and ages, periods, breakers, reported problems, worker processes."""
