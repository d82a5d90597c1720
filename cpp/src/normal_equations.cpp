#include "normal_equations.hpp"

#include <Eigen/Dense>
#include <stdexcept>

namespace plenocal {
namespace {

// Singular values of the column-scaled Jacobian below this fraction of the largest count as zero.
// They come as square roots of eigenvalues of J'J, which carry an error near
// size * epsilon ~ 1e-14 of the largest: values below 1e-7 cannot be distinguished from zero.
constexpr double kRankTolerance = 1e-7;

Group zero_group(int size) {
  return {Eigen::MatrixXd::Zero(size, size), Eigen::VectorXd::Zero(size)};
}

// Only the lower triangle of the information, until `mirror`.
void add_rows(const Eigen::MatrixXd& jacobian, const Eigen::VectorXd& residuals, Group* group) {
  group->information.selfadjointView<Eigen::Lower>().rankUpdate(jacobian.transpose());
  group->gradient += jacobian.transpose() * residuals;
}

void mirror(Eigen::MatrixXd* lower) {
  lower->triangularView<Eigen::StrictlyUpper>() = lower->transpose();
}

class Accumulator {
 public:
  Accumulator(int intrinsics, int frames, int corners, int anchors,
              const std::vector<CommonError>& common)
      : common_(common),
        by_kind_(frames,
                 {zero_group(intrinsics + Pose::kSize), zero_group(intrinsics + Pose::kSize)}),
        corners_(corners, zero_group(Pose::kSize)),
        frame_of_corner_(corners, 0),
        rho_(corners),
        anchors_(zero_group(intrinsics)) {
    equations_.intrinsics = intrinsics;
    const int size = intrinsics + Pose::kSize * frames;
    for (auto& information : equations_.information) information.setZero(size, size);
    equations_.gradient.setZero(size);
    equations_.patches.assign(kPatches, zero_group(intrinsics));
    equations_.corners.resize(frames);
    equations_.by_common_observations.setZero(size, static_cast<Eigen::Index>(common.size()));
    equations_.by_common_anchors = equations_.by_common_observations;
    equations_.in_anchors.setZero(size, anchors);
    equations_.anchors.setZero(anchors, intrinsics);
  }

  void add(const CalibrationProblem::Linearised& block, const std::vector<RowOrigin>& rows) {
    const RowOrigin& first = rows[block.first_row];
    const int n = static_cast<int>(block.residuals.size());
    if (first.corner >= 0) {
      add_features(block, rows);
    } else if (block.jacobian.cols() > 0) {
      for (int i = 0; i < n; ++i) {
        const RowOrigin& row = rows[block.first_row + i];
        add_rows(block.jacobian.row(i), block.residuals.segment<1>(i),
                 row.kind == kCenter ? &equations_.patches[row.group] : &anchors_);
        if (row.kind == kAnchor) add_anchor(block.jacobian.row(i), row);
        // u comes before v.
        if (row.kind == kCenter) add_center(block.jacobian.row(i), row, i % 2 == 0);
      }
    }
    for (int i = 0; i < n; ++i) {
      const RowOrigin& row = rows[block.first_row + i];
      const double residual = block.residuals[i];
      if (row.kind == kRho) {
        rho_[row.corner].sum += residual;
        ++rho_[row.corner].count;
      } else {
        equations_.squares[row.kind] += residual * residual;
        ++equations_.terms[row.kind];
      }
      equations_.pixel_squares[row.kind] += std::pow(residual * row.std_dev, 2);
      ++equations_.count[row.kind];
    }
  }

  NormalEquations finish() {
    const int p = equations_.intrinsics;
    for (std::size_t frame = 0; frame < by_kind_.size(); ++frame) {
      const int pose = equations_.pose(static_cast<int>(frame));
      Group sum = zero_group(p + Pose::kSize);
      for (ResidualKind kind : {kUv, kRho}) {
        Group& group = by_kind_[frame][kind];
        mirror(&group.information);
        sum.information += group.information;
        sum.gradient += group.gradient;
        equations_.gradient.head(p) += group.gradient.head(p);
        equations_.gradient.segment<Pose::kSize>(pose) += group.gradient.tail<Pose::kSize>();
        Eigen::MatrixXd& all = equations_.information[kind];
        all.topLeftCorner(p, p) += group.information.topLeftCorner(p, p);
        all.block(pose, 0, Pose::kSize, p) = group.information.bottomLeftCorner(Pose::kSize, p);
        all.block(0, pose, p, Pose::kSize) = group.information.topRightCorner(p, Pose::kSize);
        all.block<Pose::kSize, Pose::kSize>(pose, pose) =
            group.information.bottomRightCorner<Pose::kSize, Pose::kSize>();
      }
      equations_.frames.push_back(std::move(sum));
    }
    for (std::size_t corner = 0; corner < corners_.size(); ++corner) {
      const auto& [sum, count] = rho_[corner];
      if (count > 0) {
        equations_.squares[kRho] += sum * sum / count;
        ++equations_.terms[kRho];
      }
      mirror(&corners_[corner].information);
      equations_.corners[frame_of_corner_[corner]].push_back(std::move(corners_[corner]));
    }
    for (Group& patch : equations_.patches) {
      mirror(&patch.information);
      equations_.information[kCenter].topLeftCorner(p, p) += patch.information;
      equations_.gradient.head(p) += patch.gradient;
    }
    mirror(&anchors_.information);
    equations_.information[kAnchor].topLeftCorner(p, p) = anchors_.information;
    equations_.gradient.head(p) += anchors_.gradient;
    return std::move(equations_);
  }

 private:
  // A block of features: all of one frame.
  void add_features(const CalibrationProblem::Linearised& block,
                    const std::vector<RowOrigin>& rows) {
    const int n = static_cast<int>(block.residuals.size());
    const int p = equations_.intrinsics;
    const int frame = rows[block.first_row].group, pose = equations_.pose(frame);
    for (ResidualKind kind : {kUv, kRho}) {
      std::vector<int> of_kind;
      for (int i = 0; i < n; ++i) {
        if (rows[block.first_row + i].kind == kind) of_kind.push_back(i);
      }
      add_rows(block.jacobian(of_kind, Eigen::all), block.residuals(of_kind),
               &by_kind_[frame][kind]);
    }
    for (int i = 0; i < n;) {
      const int begin = i, corner = rows[block.first_row + i].corner;
      while (i < n && rows[block.first_row + i].corner == corner) ++i;
      add_rows(block.jacobian.block(begin, p, i - begin, Pose::kSize),
               block.residuals.segment(begin, i - begin), &corners_[corner]);
      frame_of_corner_[corner] = frame;
    }
    for (std::size_t k = 0; k < common_.size(); ++k) {
      Eigen::VectorXd moved(n);
      for (int i = 0; i < n; ++i) {
        const RowOrigin& row = rows[block.first_row + i];
        const Feature<double>& by = common_[k].features[row.observation];
        // u comes before v.
        const bool is_u = i == 0 || rows[block.first_row + i - 1].observation != row.observation;
        moved[i] = (row.kind == kRho ? by.rho : is_u ? by.u : by.v) / row.std_dev;
      }
      const Eigen::VectorXd change = block.jacobian.transpose() * moved;
      auto sum = equations_.by_common_observations.col(static_cast<Eigen::Index>(k));
      sum.head(p) += change.head(p);
      sum.segment<Pose::kSize>(pose) += change.tail<Pose::kSize>();
    }
  }

  void add_center(const Eigen::RowVectorXd& jacobian, const RowOrigin& row, bool is_u) {
    for (std::size_t k = 0; k < common_.size(); ++k) {
      if (common_[k].centers.empty()) continue;
      const Pixel<double>& by = common_[k].centers[row.observation];
      equations_.by_common_observations.col(static_cast<Eigen::Index>(k))
          .head(equations_.intrinsics) += (is_u ? by.u : by.v) / row.std_dev * jacobian.transpose();
    }
  }

  void add_anchor(const Eigen::RowVectorXd& jacobian, const RowOrigin& row) {
    equations_.anchors.row(row.group) = jacobian;
    double contained = 0.0;
    for (std::size_t k = 0; k < common_.size(); ++k) {
      const std::vector<double>& moved = common_[k].anchors;
      if (moved.empty()) continue;
      const Eigen::VectorXd change = moved[row.group] * jacobian.transpose();
      const auto column = static_cast<Eigen::Index>(k);
      equations_.by_common_anchors.col(column).head(equations_.intrinsics) += change;
      if (common_[k].in_anchors) contained += moved[row.group] * moved[row.group];
    }
    equations_.in_anchors.col(row.group).head(equations_.intrinsics) =
        std::sqrt(contained) * jacobian.transpose();
  }

  const std::vector<CommonError>& common_;
  NormalEquations equations_;
  std::vector<std::array<Group, 2>> by_kind_;  // of frames: kUv, kRho
  std::vector<Group> corners_;
  std::vector<int> frame_of_corner_;
  struct Sum {
    double sum = 0.0;
    int count = 0;
  };
  std::vector<Sum> rho_;  // of corners
  Group anchors_;
};

}  // namespace

GroupGradients group_gradients(const CalibrationProblem& calibration) {
  const auto p = static_cast<Eigen::Index>(calibration.free_intrinsics().size());
  GroupGradients gradients;
  gradients.patches.assign(kPatches, Eigen::VectorXd::Zero(p));
  calibration.linearise([&](const CalibrationProblem::Linearised& block) {
    const RowOrigin* rows = &calibration.rows()[block.first_row];
    if (rows->kind == kUv) {
      gradients.frames.resize(std::max<std::size_t>(gradients.frames.size(), rows->group + 1),
                              Eigen::VectorXd::Zero(p + Pose::kSize));
      gradients.frames[rows->group] += block.jacobian.transpose() * block.residuals;
    } else if (rows->kind == kCenter) {
      for (Eigen::Index i = 0; i < block.residuals.size(); ++i) {
        gradients.patches[rows[i].group] += block.residuals[i] * block.jacobian.row(i).transpose();
      }
    }
  });
  return gradients;
}

NormalEquations normal_equations(const CalibrationProblem& calibration,
                                 const std::vector<CommonError>& common) {
  int frames = 0, corners = 0, anchors = 0;
  for (const RowOrigin& row : calibration.rows()) {
    anchors += row.kind == kAnchor ? 1 : 0;
    if (row.corner < 0) continue;
    frames = std::max(frames, row.group + 1);
    corners = std::max(corners, row.corner + 1);
  }
  Accumulator sum(static_cast<int>(calibration.free_intrinsics().size()), frames, corners, anchors,
                  common);
  calibration.linearise(
      [&](const CalibrationProblem::Linearised& block) { sum.add(block, calibration.rows()); });
  return sum.finish();
}

ScaledInverse::ScaledInverse(const Eigen::MatrixXd& information) {
  if (information.size() == 0) return;
  const Eigen::VectorXd scale =
      information.diagonal().unaryExpr([](double v) { return v > 0.0 ? 1.0 / std::sqrt(v) : 1.0; });
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(scale.asDiagonal() * information *
                                                             scale.asDiagonal());
  const double threshold =
      kRankTolerance * kRankTolerance * eigen.eigenvalues().cwiseAbs().maxCoeff();
  // Eigenvalues come in ascending order.
  inverse = eigen.eigenvalues().unaryExpr([=](double v) { return v > threshold ? 1.0 / v : 0.0; });
  vectors = eigen.eigenvectors();
  basis = scale.asDiagonal() * vectors;
  coordinates = scale.cwiseInverse().asDiagonal() * vectors;
  rank = static_cast<int>((inverse.array() > 0.0).count());
}

}  // namespace plenocal
