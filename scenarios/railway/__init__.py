"""What settings on rails share: lines and trains, the dynamics, a drive over a line."""
