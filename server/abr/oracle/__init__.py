"""What no policy can beat, knowing the link of the whole play beforehand."""
