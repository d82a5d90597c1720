// Silence of glog while Ceres works.
#pragma once

#include <glog/logging.h>

namespace plenocal {

// Ceres warns on stderr through glog of steps that leave the model's domain, which are no news.
class QuietLog {
 public:
  QuietLog() : level_(FLAGS_minloglevel) { FLAGS_minloglevel = google::GLOG_ERROR; }
  ~QuietLog() { FLAGS_minloglevel = level_; }
  QuietLog(const QuietLog&) = delete;
  QuietLog& operator=(const QuietLog&) = delete;

 private:
  int level_;
};

}  // namespace plenocal
