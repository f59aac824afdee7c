// Points entries of the tables through which Python's own libraries call the C library to other functions.
#pragma once
#include <vector>

namespace simulated_time {
struct Redirection {
  const char* name;
  void* ours;
};
using Redirections = std::vector<Redirection>;

// Redirects all of Python's libraries that are loaded now.
void redirect_python(const Redirections& redirections);
}  // namespace simulated_time
