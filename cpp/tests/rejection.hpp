// Input that is rejected, and the messages.
#pragma once

#include <gtest/gtest.h>

#include <functional>
#include <stdexcept>
#include <string>

namespace plenocal::test {

/// The message of the std::invalid_argument that an action throws.
inline std::string rejection(const std::function<void()>& action) {
  try {
    action();
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "(accepted)";
}

/// A message has to contain what is wrong.
inline void expect_names(const std::string& message, const std::string& culprit) {
  EXPECT_NE(message.find(culprit), std::string::npos)
      << "message: " << message << "\nwithout: " << culprit;
}

}  // namespace plenocal::test
